"""Restart counter: starts of this boot, and those that no orderly end came before."""

import contextlib
from pathlib import Path
from typing import NamedTuple

from vcu_gateway import files

HIDDEN = "-"
"""Stands for a boot identifier that cannot be read."""

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_NAME = "starts"
_RUNNING, _ENDED = "running", "ended"


def boot_id() -> str:
    """Boot identifier of the kernel; `HIDDEN` where it cannot be read: /run ends with the boot."""
    try:
        return _BOOT_ID.read_text(encoding="ascii").strip() or HIDDEN
    except OSError:
        return HIDDEN


class CountedStart(NamedTuple):
    """One start of the gateway.

    Attributes:
        number: since the machine booted, from 1.
        unexpected: starts of this drive that no end came before: killed, hung or crashed.
            A drive begins with the first start after an orderly end.
    """

    number: int
    unexpected: int


class RestartCounter:
    """Counter of one gateway's starts, in a file of its runtime folder."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME
        self._now: CountedStart | None = None

    def begin(self) -> CountedStart | None:
        """Count this start; None where nothing can be kept and nothing is known of any before."""
        before, ended = self._known()
        now = CountedStart(before.number + 1, 0 if ended else before.unexpected + 1)
        self._now = now if self._write(now, _RUNNING) else None
        return now if self._now or before.number else None

    def end(self) -> None:
        if self._now is not None:
            self._write(self._now, _ENDED)

    def _known(self) -> tuple[CountedStart, bool]:
        with contextlib.suppress(OSError, ValueError):
            boot, number, unexpected, state = self._path.read_text(encoding="ascii").split()
            if boot == boot_id():
                return CountedStart(int(number), int(unexpected)), state == _ENDED
        return CountedStart(0, 0), True

    def _write(self, start: CountedStart, state: str) -> bool:
        text = f"{boot_id()} {start.number} {start.unexpected} {state}\n"
        try:
            files.replace(self._path, text)
        except OSError:
            return False
        return True
