"""Pairs of wall-clock and monotonic time, while the scheduler tears the readings apart."""

import pytest

from vcu_gateway.bus import settings
from vcu_gateway.core.schedule import ClockPair

MS = 1_000_000
WALL_NS = 1_700_000_000_000_000_000


class TornClock:
    """A clock whose readings of the wall time take so long, one after the other."""

    def __init__(self, *took_ns: int) -> None:
        self._took_ns = list(took_ns)
        self._now_ns = 0

    def monotonic_ns(self) -> int:
        return self._now_ns

    def time_ns(self) -> int:
        read_ns = WALL_NS + self._now_ns
        self._now_ns += self._took_ns.pop(0)
        return read_ns


@pytest.mark.parametrize(
    ("took_ns", "read_at_ns"),
    [
        ((50_000,), 0),
        ((50_001, 50_000), 50_001),
        ((9 * MS, 3 * MS, 50_000), 12 * MS),
        ((9 * MS, 3 * MS, 5 * MS), 9 * MS),
    ],
)
def test_a_torn_reading_is_taken_again_and_the_closest_of_three_counts(
    monkeypatch, took_ns, read_at_ns
):
    monkeypatch.setattr(settings, "time", TornClock(*took_ns))
    assert settings.read_clocks() == ClockPair(read_at_ns, WALL_NS + read_at_ns)
