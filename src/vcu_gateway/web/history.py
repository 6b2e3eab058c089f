"""Every signal over the last ten minutes, ten times a second, in arrays of a fixed size.

Answers with samples, encoded once for all who ask for the same, beside the loop.
"""

import asyncio
import json
import math
import time
from array import array
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypedDict

from vcu_gateway.units import NS_PER_MS
from vcu_gateway.web.page_files import EncodedBody
from vcu_gateway.web.state_row import is_number, object_at, part_of

KEPT_S = 600
RATE_HZ = 10
CAPACITY = KEPT_S * RATE_HZ
MOST_SIGNALS = 8

_NAN = float("nan")
_PERIOD_MS = 1000 / RATE_HZ
_LEAST_APART_MS = 0.9 * _PERIOD_MS
_MOST_APART_MS = 3 * _PERIOD_MS
_LIVE = ("good", "out of range", "saturated")
_COMMANDED = ("throttle_pct", "brake_pct", "speed_limit_rpm", "power_limit_w")


class Samples(TypedDict):
    """Times by the monotonic clock, and a value of each signal at each; None is a gap."""

    times_ms: list[int]
    values: dict[str, list[float | None]]


class History:
    """Ring of samples: a time and a number for each signal, NaN where there was no live one.

    Signals are named MESSAGE.SIGNAL, what was commanded CONTROLLER.commanded.VALUE.
    """

    def __init__(self) -> None:
        self._times_ms = array("d", bytes(8 * CAPACITY))
        self._columns: dict[str, array[float]] = {}
        self._count = 0

    def add(self, state: Any) -> None:
        """One sample, unless the last one is younger than a tenth of a second.

        Where none came for three periods, one without values stands between: a gap.
        """
        time_ms = state["monotonic_ns"] / NS_PER_MS
        if self._count:
            last_ms = self._times_ms[(self._count - 1) % CAPACITY]
            if time_ms - last_ms < _LEAST_APART_MS:
                return
            if time_ms - last_ms > _MOST_APART_MS:
                self._put(last_ms + _PERIOD_MS, ())
        self._put(time_ms, _values(state))

    def _put(self, time_ms: float, values: Iterable[tuple[str, float]]) -> None:
        at = self._count % CAPACITY
        for column in self._columns.values():
            column[at] = _NAN
        for name, value in values:
            if name not in self._columns:
                self._columns[name] = array("f", [_NAN]) * CAPACITY
            self._columns[name][at] = value
        self._times_ms[at] = time_ms
        self._count += 1

    @property
    def names(self) -> list[str]:
        return list(self._columns)

    def read(self, names: Iterable[str], points: int) -> Samples:
        """The samples of these signals, thinned to about so many points.

        The least and the greatest value of each stretch stay, so that no peak is lost; where a gap
        begins or ends every sample stays.
        """
        names = tuple(names)
        order = range(max(0, self._count - CAPACITY), self._count)
        size = max(1, -(-2 * len(order) // points))
        stretches = [
            part
            for at in range(0, len(order), size)
            for part in self._without_gap_inside(order[at : at + size], names)
        ]
        return {
            "times_ms": [round(time) for time in self._stretch_times_ms(stretches)],
            "values": {name: self._thinned(name, stretches) for name in names},
        }

    def _without_gap_inside(self, stretch: range, names: Iterable[str]) -> list[range]:
        """The stretch, or its samples one by one where a gap of one signal begins or ends in it."""
        columns = [self._columns[name] for name in names]
        gaps = ({math.isnan(column[at % CAPACITY]) for at in stretch} for column in columns)
        is_mixed = any(len(kinds) > 1 for kinds in gaps)
        return [stretch[at : at + 1] for at in range(len(stretch))] if is_mixed else [stretch]

    def _stretch_times_ms(self, stretches: list[range]) -> Iterator[float]:
        for stretch in stretches:
            yield self._times_ms[stretch[0] % CAPACITY]
            if len(stretch) > 1:
                yield self._times_ms[stretch[-1] % CAPACITY]

    def _thinned(self, name: str, stretches: list[range]) -> list[float | None]:
        column = self._columns[name]
        values = ([column[at % CAPACITY] for at in stretch] for stretch in stretches)
        return [end for of_stretch in values for end in _extremes(of_stretch)]


def _extremes(values: list[float]) -> list[float | None]:
    """Least and greatest in the order in which they came; one value where there is one."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return [None] * min(2, len(values))
    least, greatest = min(known), max(known)
    rising = known.index(least) <= known.index(greatest)
    ends = [least, greatest] if rising else [greatest, least]
    return [float(f"{value:.6g}") for value in ends[: len(values)]]


def _values(state: Any) -> Iterator[tuple[str, float]]:
    """Whatever is not as it should be is a gap."""
    for message_name, message in object_at(state, "messages").items():
        for name, signal in object_at(message, "signals").items():
            is_live = part_of(signal, "quality") in _LIVE
            yield f"{message_name}.{name}", _float(signal, "value") if is_live else _NAN
    for controller, command in object_at(state, "commands").items():
        for key in _COMMANDED:
            yield f"{controller}.commanded.{key}", _float(command, key)


def _float(value: Any, key: str) -> float:
    inner = part_of(value, key)
    return float(inner) if is_number(inner) else _NAN


_KEPT_S = 1.0
_KEPT = 16


class PreparedSamples:
    """Encoded samples, each a second old at most; one answer is put together at a time.

    That is done on another thread: a stop does not wait for it.
    """

    def __init__(
        self,
        read: Callable[[tuple[str, ...], int], Samples],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._read = read
        self._now_s = now_s
        self._kept: dict[tuple[tuple[str, ...], int], tuple[float, EncodedBody]] = {}
        self._one_at_a_time = asyncio.Lock()

    async def encoded(self, names: tuple[str, ...], points: int) -> EncodedBody:
        question = (names, points)
        async with self._one_at_a_time:
            kept = self._kept.get(question)
            if kept is not None and self._now_s() - kept[0] < _KEPT_S:
                return kept[1]
            encoded = await asyncio.to_thread(self._encode, names, points)
            self._kept.pop(question, None)
            self._kept[question] = (self._now_s(), encoded)
            if len(self._kept) > _KEPT:
                del self._kept[next(iter(self._kept))]
            return encoded

    def _encode(self, names: tuple[str, ...], points: int) -> EncodedBody:
        plain = json.dumps(self._read(names, points), separators=(",", ":")).encode()
        return EncodedBody.of("application/json", plain)
