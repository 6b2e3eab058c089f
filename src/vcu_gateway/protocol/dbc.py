"""DBC file -> protocol: known beforehand for the packaged DBC, else read by cantools."""

import hashlib
from pathlib import Path

from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import MissingInputError, Problem
from vcu_gateway.protocol import vcu_dbc


def load(path: Path) -> ProtocolSpec:
    """Read a DBC for the decoders and encoders.

    Raises MissingInputError where it cannot be read, DataError where it is no DBC or holds
    what this gateway cannot decode.
    """
    if path.exists() and not path.is_file():
        raise MissingInputError(Problem("is no regular file", str(path)))
    try:
        contents = path.read_bytes()
        text = contents.decode().replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise MissingInputError(Problem(f"cannot be read: {error}", str(path))) from error
    if hashlib.sha256(contents).hexdigest() == vcu_dbc.SHA256:
        return vcu_dbc.PROTOCOL
    # Imported where it is needed: no start with the packaged DBC waits for cantools.
    from vcu_gateway.protocol import cantools_dbc

    return cantools_dbc.parse(text, str(path))
