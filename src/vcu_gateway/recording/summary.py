"""What a recording held, counted in bounded memory."""

from collections import Counter
from collections.abc import Iterator

from vcu_gateway.core.codec import Reason

CAN_FD = "fd"
"""Beside the reasons of the codec: a classic bus has no CAN FD frames."""

_SHOWN_IDENTIFIERS = 10
_KEPT_IDENTIFIERS = 4096
_BY_IDENTIFIER = (Reason.UNKNOWN, Reason.FOREIGN_SOURCE, Reason.STANDARD)


class Tally:
    """Counts identifiers; with very many of them, the rare ones are forgotten by name.

    Attributes:
        forgotten: frames whose identifier is no longer kept.
    """

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self.forgotten = 0

    def add(self, can_id: int) -> None:
        self._counts[can_id] += 1
        if len(self._counts) > _KEPT_IDENTIFIERS:
            kept = Counter(dict(self._counts.most_common(_KEPT_IDENTIFIERS // 2)))
            self.forgotten += self._counts.total() - kept.total()
            self._counts = kept

    def lines(self, digits: int) -> Iterator[str]:
        """The most frequent identifiers, and the frames of all others in one line."""
        shown = self._counts.most_common(_SHOWN_IDENTIFIERS)
        at_least = "at least " if self.forgotten else ""
        for can_id, count in shown:
            yield f"{can_id:0{digits}X} {at_least}{count}"
        rest = self._counts.total() + self.forgotten - sum(count for _, count in shown)
        if rest:
            yield f"others {rest}"


class Summary:
    """Frames of one recording by what became of them.

    Attributes:
        decoded: frames written, by message.
        passed_over: frames that `--message` did not ask for.
    """

    def __init__(self) -> None:
        self.decoded: Counter[str] = Counter()
        self.passed_over = 0
        self._rejected: Counter[str] = Counter()
        self._identifiers = {reason: Tally() for reason in _BY_IDENTIFIER}

    @property
    def frames(self) -> int:
        return self.decoded.total() + self.passed_over + self._rejected.total()

    def reject(self, reason: Reason, can_id: int) -> None:
        self._rejected[reason.value] += 1
        if reason in self._identifiers:
            self._identifiers[reason].add(can_id)

    def reject_fd(self) -> None:
        self._rejected[CAN_FD] += 1

    def lines(self, unreadable: int) -> Iterator[str]:
        """The summary, for people; what is unreadable is no frame."""
        rejected = self._rejected.total()
        yield (
            f"frames {self.frames}: decoded {self.decoded.total()}, not decoded {rejected}"
            + (f", not asked for {self.passed_over}" if self.passed_over else "")
            + (f"; unreadable {unreadable}" if unreadable else "")
        )
        yield from (f"  {name} {count}" for name, count in sorted(self.decoded.items()))
        if rejected:
            yield "not decoded:"
        for reason, count in self._rejected.most_common():
            yield f"  {reason} {count}"
            tally = self._identifiers.get(Reason(reason)) if reason != CAN_FD else None
            if tally:
                digits = 3 if reason == Reason.STANDARD.value else 8
                yield from (f"    {line}" for line in tally.lines(digits))
