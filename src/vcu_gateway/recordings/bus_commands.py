"""Commands of a recording, which has each twice: as it was sent, and as the bus gave it back.

    core lines   {"f":9,"tick":...,"frames":[["PCU1","0008A7D0","0c000000e02e0000"],...]}
    frames       (1763920000.123456789) can0 0008A7D0#0C000000E02E0000 T

Every echo has to be one of the commands that were sent before it, in their order. A command
without an echo is none of this: a bus that took no frame gave none back.
"""

import re
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

_ECHO = re.compile(rb" ([0-9A-Fa-f]{1,8})#([!-~]{0,200}) T$", re.MULTILINE)
_KEPT_FROM_BEFORE = 100
_NOT_JUDGED = 2
"""Echoes at the begin of what was recorded: their commands may stand before it."""


class BusCommand(NamedTuple):
    """A frame of the gateway's own.

    Attributes:
        place: frames of the segment before it.
        identifier, data: hexadecimal digits, capital.
    """

    place: int
    identifier: str
    data: str


def commands_in(line: Mapping[str, Any]) -> Iterator[BusCommand]:
    """Frames that a core line says were sent, or were to be; ValueError where they are wrong."""
    frames = line["frames"] if "tick" in line and "frames" in line else []
    if "sent" in line:
        frames = [line["sent"]]
    for _, identifier, data in frames:
        yield BusCommand(line["f"], identifier.upper(), data.upper())


def echoes_in(data: bytes, first_line: int) -> Iterator[BusCommand]:
    place, counted = first_line, 0
    for found in _ECHO.finditer(data):
        place += data.count(b"\n", counted, found.start())
        counted = found.start()
        yield BusCommand(place, found[1].decode().upper(), found[2].decode().upper())


class EchoCheck:
    """Compares echoes with the commands sent before them, over the segments of a drive."""

    def __init__(self) -> None:
        self._sent: dict[str, deque[BusCommand]] = defaultdict(deque)
        self._not_judged: dict[str, int] = {}
        self._begun = False

    def segment(
        self, commands: Iterable[BusCommand], echoes: Iterable[BusCommand], follows: bool
    ) -> Iterator[BusCommand]:
        """Echoes of the next segment that no command explains.

        `follows`: nothing is missing between it and the one before.
        """
        if not (follows and self._begun):
            self._sent.clear()
            self._not_judged = defaultdict(lambda: _NOT_JUDGED)
        self._begun = True
        for waiting in self._sent.values():  # they were sent before this segment
            late = [command._replace(place=-1) for command in waiting][-_KEPT_FROM_BEFORE:]
            waiting.clear()
            waiting.extend(late)
        for command in commands:
            self._sent[command.identifier].append(command)
        return (echo for echo in echoes if not self._explained(echo))

    def _explained(self, echo: BusCommand) -> bool:
        sent = self._sent[echo.identifier]
        for number, command in enumerate(sent):
            if command.place > echo.place:
                break
            if command.data == echo.data:
                for _ in range(number + 1):
                    sent.popleft()
                self._not_judged[echo.identifier] = 0
                return True
        self._not_judged[echo.identifier] -= 1
        return self._not_judged[echo.identifier] >= 0
