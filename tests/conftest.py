"""What every room of the tests starts from."""

import dataclasses
from collections.abc import Mapping

import pytest

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, packaged


@pytest.fixture(scope="session")
def protocol() -> ProtocolSpec:
    """The protocol as the daemon loads it: the packaged DBC and the default aliases."""
    spec = dbc.load(packaged("vcu.dbc"))
    return dataclasses.replace(spec, aliases=DEFAULT_ALIASES)


@pytest.fixture(scope="session")
def codec(protocol: ProtocolSpec) -> Codec:
    return Codec(protocol)


def payload(codec: Codec, message: str, values: Mapping[str, float]) -> bytes:
    """Eight bytes of this message; signals left out are the code nearest to 0."""
    return codec.by_name[message].encode(values)
