"""Lines of a plot on a common grid: of each bucket the earlier and the later of its extremes.

So a peak of one frame stays visible however far an hour is drawn together, and a line has two
points a bucket however many frames there were.
"""

from array import array
from collections.abc import Iterable, Sequence
from typing import NamedTuple

GAP = -(1 << 31)
"""Stands for a bucket without a value."""

LARGEST_CODE = (1 << 31) - 1


class CodeLine(NamedTuple):
    """Extremes of each bucket in the order in which they came; GAP where there is none."""

    earlier: "array[int]"
    later: "array[int]"

    @property
    def constant(self) -> int | None:
        """The only code of the line; None where there are several, or none at all."""
        codes = set(self.earlier) | set(self.later)
        codes.discard(GAP)
        return codes.pop() if len(codes) == 1 else None

    @property
    def empty(self) -> bool:
        return max(self.later, default=GAP) == GAP

    def halved(self) -> "CodeLine":
        """The same on a grid of twice the width."""
        if len(self.later) % 2:
            self.earlier.append(GAP)
            self.later.append(GAP)
        pairs = zip(
            self.earlier[::2], self.later[::2], self.earlier[1::2], self.later[1::2], strict=True
        )
        merged = [_merged(*four) for four in pairs]
        return CodeLine(array("i", [a for a, _ in merged]), array("i", [b for _, b in merged]))


def _merged(first: int, second: int, third: int, fourth: int) -> tuple[int, int]:
    """Extremes of two buckets, in their order."""
    if third == GAP or first == GAP:
        return (first, second) if third == GAP else (third, fourth)
    if first == second == third == fourth:
        return first, first
    four = (first, second, third, fourth)
    low, high = min(four), max(four)
    return (low, high) if four.index(low) < four.index(high) else (high, low)


class LineBuilder:
    """Gathers the codes of one signal; the stamps may only rise."""

    def __init__(self, buckets: int) -> None:
        self._earlier = array("i", [GAP]) * buckets
        self._later = array("i", [GAP]) * buckets
        self._bucket = -1

    def add(self, buckets: Iterable[int], codes: Iterable[int]) -> None:
        """Take in codes, each with the number of its bucket."""
        earlier, later, current = self._earlier, self._later, self._bucket
        for bucket, code in zip(buckets, codes, strict=True):
            if bucket > current:
                earlier[bucket] = later[bucket] = code
                current = bucket
                continue
            before, after = earlier[current], later[current]
            if before <= after:
                if code > after:
                    later[current] = code
                elif code < before:
                    earlier[current], later[current] = after, code
            elif code < after:
                later[current] = code
            elif code > before:
                earlier[current], later[current] = after, code
        self._bucket = current

    def line(self, hold_buckets: int) -> CodeLine:
        """The line; a value is held for so many buckets without a new one."""
        earlier, later = self._earlier, self._later
        held, since = GAP, 0
        for bucket, code in enumerate(later):
            if code != GAP:
                held, since = code, bucket
            elif held != GAP and bucket - since <= hold_buckets:
                earlier[bucket] = later[bucket] = held
        return CodeLine(earlier, later)


def sampled(
    buckets: Sequence[int], codes: Sequence[int], count: int, hold_buckets: int
) -> CodeLine:
    builder = LineBuilder(count)
    builder.add(buckets, codes)
    return builder.line(hold_buckets)
