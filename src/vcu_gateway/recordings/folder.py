"""Folder of all recordings: drives and incidents by name."""

import os
from pathlib import Path
from typing import Literal, NamedTuple

from vcu_gateway.drive_format import layout
from vcu_gateway.errors import (
    GatewayError,
    MissingInputError,
    NotPermittedError,
    Problem,
    did_you_mean,
)

RecordingKind = Literal["drive", "incident"]

_PARENTS: tuple[tuple[RecordingKind, str], ...] = (
    ("drive", layout.DRIVES),
    ("incident", layout.INCIDENTS),
)


class RecordingPath(NamedTuple):
    """A drive's or an incident's folder."""

    kind: RecordingKind
    path: Path

    @property
    def name(self) -> str:
        return self.path.name


class RecordingFolder:
    """Folder with `drives` and `incidents` in it, as the recorder writes it.

    Attributes:
        path: where it is.
    """

    def __init__(self, path: Path) -> None:
        """MissingInputError where it is none, NotPermittedError where it may not be read."""
        self.path = path
        try:
            inside = os.listdir(path)
        except OSError as error:
            raise read_error(error, path) from error
        if not {layout.DRIVES, layout.INCIDENTS} & set(inside):
            what = "has no recordings in it"
            remedy = "is the recorder on: systemctl status vcu-gateway-recorder.socket"
            raise MissingInputError(Problem(what, str(path), remedy))

    def recordings(self) -> list[RecordingPath]:
        """All drives, then all incidents, the oldest first; links are none."""
        try:
            return [
                RecordingPath(kind, found)
                for kind, parent in _PARENTS
                for found in layout.recorded_folders(self.path / parent)
                if not found.is_symlink()
            ]
        except OSError as error:
            raise read_error(error, self.path) from error

    def named(self, name: str) -> RecordingPath:
        """The one of this name; MissingInputError where there is none."""
        known = {found.name: found for found in self.recordings()}
        if name in known:
            return known[name]
        remedy = did_you_mean(name, known) or "vcu-gateway recordings list"
        raise MissingInputError(Problem(f'no drive or incident "{name}"', str(self.path), remedy))


def read_error(error: OSError, path: Path) -> GatewayError:
    if isinstance(error, PermissionError):
        remedy = "sudo usermod -aG vcu-gateway-recorder $USER and log in again, or use sudo"
        return NotPermittedError(Problem("may not be read by this user", str(path), remedy))
    what = f"cannot be read: {error.strerror or error}"
    return MissingInputError(Problem(what, str(path), "recordings lie elsewhere? --folder"))


def write_error(error: OSError, path: Path) -> GatewayError:
    if isinstance(error, PermissionError):
        what, remedy = "may not be changed by this user", "use sudo"
        return NotPermittedError(Problem(what, str(path), remedy))
    return MissingInputError(Problem(f"cannot be changed: {error.strerror or error}", str(path)))
