"""Every signal over the last ten minutes, ten times a second, in arrays of a fixed size."""

import math
from array import array
from collections.abc import Iterable, Iterator
from typing import TypedDict

from vcu_gateway.api.results import Signal, State
from vcu_gateway.units import NS_PER_MS

KEPT_S = 600
RATE_HZ = 10
CAPACITY = KEPT_S * RATE_HZ
MOST_SIGNALS = 8

_NAN = float("nan")
_LEAST_GAP_MS = 0.9 * 1000 / RATE_HZ
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

    def add(self, state: State) -> None:
        """One sample, unless the last one is younger than a tenth of a second."""
        time_ms = state["monotonic_ns"] / NS_PER_MS
        if self._count and time_ms - self._times_ms[(self._count - 1) % CAPACITY] < _LEAST_GAP_MS:
            return
        at = self._count % CAPACITY
        for column in self._columns.values():
            column[at] = _NAN
        for name, value in _values(state):
            self._column(name)[at] = value
        self._times_ms[at] = time_ms
        self._count += 1

    def _column(self, name: str) -> "array[float]":
        column = self._columns.get(name)
        if column is None:
            column = self._columns[name] = array("f", [_NAN]) * CAPACITY
        return column

    @property
    def names(self) -> list[str]:
        """Signals that there are samples of."""
        return list(self._columns)

    def read(self, names: Iterable[str], points: int) -> Samples:
        """The samples of these signals, thinned to about so many points.

        The least and the greatest value of each stretch stay, so that no peak is lost.
        """
        order = range(max(0, self._count - CAPACITY), self._count)
        size = max(1, -(-2 * len(order) // points))
        stretches = [order[at : at + size] for at in range(0, len(order), size)]
        return {
            "times_ms": [round(time) for time in self._stretch_times_ms(stretches)],
            "values": {name: self._thinned(name, stretches) for name in names},
        }

    def _stretch_times_ms(self, stretches: list[range]) -> Iterator[float]:
        for stretch in stretches:
            yield self._times_ms[stretch[0] % CAPACITY]
            if len(stretch) > 1:
                yield self._times_ms[stretch[-1] % CAPACITY]

    def _thinned(self, name: str, stretches: list[range]) -> list[float | None]:
        column = self._columns[name]
        thinned: list[float | None] = []
        for stretch in stretches:
            values = [column[at % CAPACITY] for at in stretch]
            thinned += _extremes(values)
        return thinned


def _extremes(values: list[float]) -> list[float | None]:
    """Least and greatest in the order in which they came; one value where there is one."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return [None] * min(2, len(values))
    least, greatest = min(known), max(known)
    rising = known.index(least) <= known.index(greatest)
    ends = [least, greatest] if rising else [greatest, least]
    return [float(f"{value:.6g}") for value in ends[: len(values)]]


def _values(state: State) -> Iterator[tuple[str, float]]:
    for message_name, message in state["messages"].items():
        for name, signal in message["signals"].items():
            yield f"{message_name}.{name}", _live(signal)
    for controller, command in state["commands"].items():
        for key in _COMMANDED:
            yield f"{controller}.commanded.{key}", float(command[key])  # type: ignore[literal-required]


def _live(signal: Signal) -> float:
    is_live = signal["value"] is not None and signal["quality"] not in ("stale", "never")
    return float(signal["value"] or 0.0) if is_live else _NAN
