"""Problems of a recording, reported a bounded number of times."""

import gzip
from collections.abc import Callable
from enum import Enum

from vcu_gateway.core import j1939
from vcu_gateway.errors import DataError, GatewayError, MissingInputError, Problem

REPORTED_LIMIT = 10

_ERROR_FLAG = 1 << 29
_FLAGS = {30: "remote frames", 31: "29-bit identifiers"}
# The classes that the kernel puts into an error frame's identifier; other bits in a "class"
# are those of an identifier that was printed with 30 bits.
_ERROR_CLASSES = 0x3FF


class Verdict(Enum):
    """Kind of frame that an identifier above 29 bits stands for."""

    ERROR = "error frame"
    UNREADABLE = "unreadable"


class LineProblems:
    """Counter of what cannot be read; the first of each kind are reported.

    Attributes:
        unreadable: lines or frames that were passed over.
    """

    def __init__(self, where: Callable[[int], str], report: Callable[[Problem], None]) -> None:
        self._where = where
        self._report = report
        self._explained: set[int] = set()
        self.unreadable = 0

    def damaged(self, position: int, what: str, remedy: str = "") -> None:
        self.unreadable += 1
        if self.unreadable <= REPORTED_LIMIT:
            self._report(Problem(what, self._where(position), remedy))
        if self.unreadable == REPORTED_LIMIT:
            self._report(Problem("further damage is only counted", self._where(position)))

    def flagged(self, position: int, can_id: int) -> Verdict:
        """Explain, once an identifier, a number that does not fit 29 bits."""
        flags = [bit for bit in _FLAGS if can_id >> bit & 1]
        if can_id < 0 or can_id >> 32:
            self._explain(position, can_id, "is no identifier of 29 bits")
        elif flags:
            bits = " and ".join(
                f"bit {bit} set, SocketCAN's flag of {_FLAGS[bit]}" for bit in flags
            )
            self._explain(position, can_id, f"has {bits}")
        else:
            # What the kernel's own error frames carry needs no explanation.
            if can_id & j1939.ID_MASK & ~_ERROR_CLASSES:
                what = "has bit 29 set, SocketCAN's error-frame flag; the source prints such 30-bit"
                what += " identifiers for the IMU (docs/protocol.md E2)"
                self._explain(position, can_id, what)
            return Verdict.ERROR
        self.unreadable += 1
        return Verdict.UNREADABLE

    def _explain(self, position: int, can_id: int, what: str) -> None:
        if can_id in self._explained or len(self._explained) >= REPORTED_LIMIT:
            return
        self._explained.add(can_id)
        remedy = f"on the wire it is {can_id & j1939.ID_MASK:08X}"
        self._report(Problem(f"identifier {can_id:08X} {what}", self._where(position), remedy))

    def failure(self, position: int, error: Exception) -> GatewayError:
        """Error that ended the reading: an unreadable file, or wrong contents."""
        where = self._where(position)
        if isinstance(error, OSError) and not isinstance(error, gzip.BadGzipFile):
            return MissingInputError(Problem(f"cannot be read: {error.strerror or error}", where))
        what = f"is damaged here, {type(error).__name__}: {error}"
        return DataError(Problem(what, where, "nothing after this place was read"))
