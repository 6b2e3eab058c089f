"""Safe frames, kept in a file for `safe_stop` to send after a crash."""

import contextlib
from pathlib import Path

from vcu_gateway import files
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.schedule import Tick
from vcu_gateway.daemon.event_log import EventLog

NAME = "safe-frames"


def forget(folder: Path) -> None:
    """Remove the file of an earlier process: its frames are not those of this one."""
    with contextlib.suppress(OSError):
        (folder / NAME).unlink(missing_ok=True)


class SafeFrames:
    """File of safe frames: the interface, then one frame a line as identifier#data.

    Written anew when they change: a latched power cut stays one, and a direction is kept. It is
    there from the first frames that were sent to the orderly end.
    """

    def __init__(self, folder: Path, channel: str, gateway: Gateway, event_log: EventLog) -> None:
        self._folder = folder
        self._path = folder / NAME
        self._channel = channel
        self._gateway = gateway
        self._event_log = event_log
        self._basis: object = None
        self._failure_reported = False

    def observe(self, tick: Tick, result: TickResult) -> None:
        del tick
        applied = tuple((one.motor_reverse, one.power_cut) for one in result.commands.values())
        basis = applied, self._gateway.settings
        if result.frames and basis != self._basis and self._written():
            self._basis = basis

    def _written(self) -> bool:
        """Write the file; False, and one event, where that fails: the next tick tries again."""
        frames = self._gateway.safe_frames()
        lines = [self._channel, *(f"{one.can_id:08X}#{one.data.hex().upper()}" for one in frames)]
        try:
            files.replace(self._path, "\n".join(lines) + "\n")
        except OSError as error:
            if not self._failure_reported:
                fields = {"file": str(self._path), "reason": error.strerror}
                self._event_log.emit(Event("safe_frames_unwritten", Severity.WARNING, fields))
            self._failure_reported = True
            return False
        self._failure_reported = False
        return True

    def end(self) -> None:
        """Remove the file after an orderly end, which has sent its own safe frames."""
        forget(self._folder)
