"""Drive mode that is kept over a restart: one that only the service level leaves.

Whoever restarts the gateway, or the machine, must not leave such a mode by it.
"""

import os
from pathlib import Path
from urllib.parse import quote

from vcu_gateway import files
from vcu_gateway.core.calls import BeginInMode
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.daemon.events import EventLog

_LONGEST_BYTES = 64


class KeptDriveMode:
    """The file of one bus with the mode's name; there is none where no such mode is in use.

    A mode that cannot be kept is in use all the same: one event tells why.
    """

    def __init__(self, folder: Path, channel: str, gateway: Gateway, event_log: EventLog) -> None:
        self._path = folder / f"drive-mode-{quote(channel, safe='')}"
        self._gateway = gateway
        self._event_log = event_log
        self._written: str | None = None

    @classmethod
    def of(
        cls, channel: str, gateway: Gateway, event_log: EventLog, runtime: Path | None
    ) -> "KeptDriveMode | None":
        """In the service's StateDirectory, else beside the restart state; None without either."""
        state = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
        folder = Path(state) if state else runtime
        return None if folder is None else cls(folder, channel, gateway, event_log)

    def begin(self) -> None:
        """Have the gateway begin in the kept mode; before the first tick."""
        try:
            name = self._path.read_bytes()[:_LONGEST_BYTES].decode("utf-8", "replace").strip()
        except FileNotFoundError:
            return
        except OSError as error:
            self._fail("drive_mode_unread", error)
            return
        self._written = name
        self._gateway.apply(BeginInMode(name))

    def observe(self, result: TickResult) -> None:
        del result
        name = self._to_keep()
        if name == self._written:
            return
        self._written = name
        try:
            if name is None:
                self._path.unlink(missing_ok=True)
            else:
                files.replace(self._path, f"{name}\n")
        except OSError as error:
            self._fail("drive_mode_unwritten", error)

    def _to_keep(self) -> str | None:
        """The mode in use, or the one that waits, where only the service level leaves it."""
        modes = self._gateway.settings.tuning.modes
        for name in self._gateway.drive_modes:
            if name is not None and name in modes and modes[name].left_by_service:
                return name
        return None

    def _fail(self, event: str, error: OSError) -> None:
        fields = {"file": str(self._path), "reason": error.strerror or str(error)}
        self._event_log.emit(Event(event, Severity.WARNING, fields))
