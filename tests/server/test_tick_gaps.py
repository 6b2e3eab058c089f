"""The gaps: the API's thread works between the ticks, and only for a part of the time."""

import pytest

from vcu_gateway.server.tick_gaps import DEFAULT_SHARE, TickGaps

MS = 1_000_000
PERIOD = 50 * MS
SHARE = 20 * MS


class Machine:
    """A scripted clock, and a ticking thread that takes each tick a little late.

    Attributes:
        ticks_ns: when each tick was taken.
        next_deadline_ns: of the next tick.
    """

    def __init__(self, lateness_ns=60_000, ticks=True) -> None:
        self.now_ns, self.period_ns = 7 * MS, PERIOD
        self.worked_ns = 123 * MS
        self.next_deadline_ns = PERIOD
        self.lateness_ns = lateness_ns
        self.ticks = ticks
        self.ticks_ns: list[int] = []
        self.sleeps = 0
        self.gaps = TickGaps(
            self,
            DEFAULT_SHARE,
            lambda: self.now_ns,
            lambda: self.worked_ns,
            self.sleep,
        )
        self.gaps.wait()

    @property
    def schedule(self):
        return self

    def pass_to(self, now_ns: int) -> None:
        while self.ticks and now_ns >= self.next_deadline_ns + self.lateness_ns:
            self.ticks_ns.append(self.next_deadline_ns + self.lateness_ns)
            self.next_deadline_ns += PERIOD
        self.now_ns = now_ns

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0
        self.sleeps += 1
        self.pass_to(self.now_ns + round(duration_s * 1e9))

    def work(self, cost_ns: int) -> None:
        self.worked_ns += cost_ns
        self.pass_to(self.now_ns + cost_ns)

    def waited_from(self, now_ns: int, cost_ns: int = MS) -> int:
        """How long `wait` takes at this time."""
        self.pass_to(now_ns)
        self.gaps.wait(cost_ns)
        return self.now_ns - now_ns


@pytest.fixture
def machine():
    return Machine()


def test_in_the_middle_of_a_period_there_is_room_at_once(machine):
    assert machine.waited_from(20 * MS) == 0
    assert machine.sleeps == 0


@pytest.mark.parametrize("before_ns", [1, 60_000, MS, 2_499_999])
def test_shortly_before_a_deadline_nothing_begins_until_the_tick_was_taken(machine, before_ns):
    waited_ns = machine.waited_from(PERIOD - before_ns)
    assert waited_ns == before_ns + MS
    assert machine.ticks_ns == [PERIOD + 60_000]


def test_just_before_that_time_there_is_still_room(machine):
    assert machine.waited_from(PERIOD - 2_500_000) == 0


def test_what_costs_more_begins_earlier_or_after_the_tick(machine):
    assert machine.waited_from(PERIOD - 10 * MS, cost_ns=10 * MS) == 0
    machine = Machine()
    assert machine.waited_from(PERIOD - 10 * MS + 1, cost_ns=10 * MS) == 11 * MS - 1


def test_what_costs_more_than_there_is_ever_room_for_gets_half_a_share(machine):
    machine.work(SHARE // 2)
    assert machine.waited_from(PERIOD - 20 * MS, cost_ns=1000 * MS) == 0
    machine.work(1)
    assert machine.waited_from(PERIOD - 20 * MS + 1, cost_ns=1000 * MS) == 21 * MS - 1


@pytest.mark.parametrize("since_ns", [60_001, MS - 1])
def test_just_after_a_tick_there_is_no_room_either(machine, since_ns):
    """The API slept in its socket over the deadline, and wakes up while the tick still works."""
    assert machine.waited_from(PERIOD + since_ns) == MS - since_ns


def test_a_late_tick_has_its_time_too():
    machine = Machine(lateness_ns=7 * MS)
    waited_ns = machine.waited_from(PERIOD - MS)
    (taken_ns,) = machine.ticks_ns
    began_ns = PERIOD - MS + waited_ns
    assert MS <= began_ns - taken_ns <= 2 * MS


@pytest.mark.parametrize("from_ns", [PERIOD - MS, PERIOD + MS, PERIOD + 30 * MS])
def test_a_schedule_that_stands_still_holds_the_api_for_a_period_at_most(from_ns):
    machine = Machine(ticks=False)
    assert machine.waited_from(from_ns) <= PERIOD + MS
    assert machine.waited_from(machine.now_ns) == 0


def test_before_the_gateway_runs_there_is_room_at_once():
    machine = Machine(ticks=False)
    assert machine.waited_from(500 * MS) == 0


def test_a_schedule_that_begins_again_is_followed():
    """The daemon replaces its schedule when it starts."""
    machine = Machine(ticks=False)
    assert machine.waited_from(5000 * MS) == 0
    machine.next_deadline_ns, machine.ticks = 5010 * MS, True
    assert machine.waited_from(5008 * MS) <= 4 * MS
    assert machine.ticks_ns[0] < machine.now_ns


def flood(machine: Machine, until_ns: int, cost_ns: int) -> list[tuple[int, int]]:
    """Work as much as is let; each piece with its beginning and end."""
    pieces = []
    while machine.now_ns < until_ns:
        machine.gaps.wait(cost_ns)
        begin_ns = machine.now_ns
        machine.work(cost_ns)
        pieces.append((begin_ns, machine.now_ns))
    return pieces


@pytest.mark.parametrize("cost_ns", [10_000, 300_000, MS, 3 * MS, 9_990_000])
@pytest.mark.parametrize("lateness_ns", [60_000, 3 * MS])
def test_no_flood_works_near_a_tick(cost_ns, lateness_ns):
    machine = Machine(lateness_ns)
    pieces = flood(machine, 20 * PERIOD, cost_ns)
    ends = [PERIOD * n for n in range(1, 20)]
    for deadline_ns, taken_ns in zip(ends, machine.ticks_ns, strict=False):
        for begin_ns, end_ns in pieces:
            assert end_ns <= deadline_ns or begin_ns >= taken_ns + MS - 60_000


@pytest.mark.parametrize("ticks", [True, False])
@pytest.mark.parametrize("cost_ns", [10_000, 300_000, 3 * MS, 9_990_000])
def test_a_flood_gets_its_share_of_every_period_and_no_more(cost_ns, ticks):
    machine = Machine(ticks=ticks)
    before_ns = machine.worked_ns
    flood(machine, 20 * PERIOD, cost_ns)
    share = (machine.worked_ns - before_ns) / (20 * PERIOD)
    assert 0.19 < share < 0.41


def test_time_that_others_worked_does_not_count(machine):
    """CPU time of this thread, not time on the clock."""
    for _ in range(30):
        machine.pass_to(machine.now_ns + MS)
        assert machine.waited_from(machine.now_ns) == 0


def test_the_share_begins_anew_after_each_tick(machine):
    machine.pass_to(10 * MS)
    machine.work(SHARE)
    assert machine.waited_from(machine.now_ns) == 21 * MS
    machine.work(SHARE - MS)
    assert machine.waited_from(machine.now_ns) == 0
