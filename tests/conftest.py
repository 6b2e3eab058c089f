"""Settings of all tests."""

import dataclasses
import os
import signal
from collections.abc import Mapping

import pytest
from hypothesis import HealthCheck, settings

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, packaged

pytest_plugins = ["tests.stalls"]

# A machine that has it hides what is left in the buffers of the standard streams at the end.
os.environ.pop("PYTHONUNBUFFERED", None)
# Readline leaves these behind, and a program would take its terminal to be of that size always.
for name in ("COLUMNS", "LINES"):
    os.environ.pop(name, None)

# HYPOTHESIS_PROFILE=nightly: as many examples as a night has room for.
# How long examples take to make is judged by the wall clock: a busy machine is not a bad strategy.
PATIENT = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True)
settings.register_profile("ordinary", PATIENT)
settings.register_profile("nightly", PATIENT, max_examples=1200)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ordinary"))


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> None:
    """What tests start can be interrupted, though a shell began them in the background.

    Without job control it has its background jobs ignore SIGINT, and programs hand that on.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


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
