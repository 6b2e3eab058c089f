"""What waits when a tick begins is read before it decides, also after the process stood still."""

import contextlib
import signal
import time
from collections.abc import Iterator

from tests.oracle import wire
from tests.oracle.bench import Bench


@contextlib.contextmanager
def frozen(bench: Bench, seconds: float) -> Iterator[None]:
    """The process stands still for so long; what is done meanwhile waits for it."""
    bench.rules.frozen(time.monotonic() + seconds)
    bench.gateway.signal(signal.SIGSTOP)
    ends = time.monotonic() + seconds
    try:
        yield
        time.sleep(max(0.0, ends - time.monotonic()))
    finally:
        bench.gateway.signal(signal.SIGCONT)


def test_after_a_stall_with_a_cut_waiting_no_frame_carries_torque(bench, figures):
    def cut(number: int) -> bool:
        bench.standby()
        bench.drive(throttle_pct=30)
        bench.rest(0.007 * number)
        bench.demand(throttle_pct=30)
        bench.let_go()
        with frozen(bench, 0.160):
            time.sleep(0.05)
            bench.vehicle.script((0.0, "BMS_Status", {"InternalFault": 1}))
        ended = time.monotonic()
        bench.rest(0.12)
        frames = bench.commands(ended - 0.02)
        return bool(frames) and all(f.data == wire.POWER_CUT for f in frames)

    cuts = bench.of_ten(cut, still_s=0.160 + 0.050)
    figures.append(f"160 ms still with a CUT waiting: safe from the first frame on {cuts} of 10")
    assert cuts == 10


def test_a_tick_350_ms_late_latches_whatever_waits(bench, figures):
    """A demand that waits for it, a disarm, a demand that expired meanwhile."""

    def latched(number: int) -> bool:
        bench.standby()
        bench.drive(throttle_pct=30)
        bench.rest(0.007 * number)
        bench.let_go()
        sent = time.monotonic()
        bench.client.demand(bench.source, ttl_ms=200, throttle_pct=30)
        bench.rules.asked(sent, time.monotonic(), {"throttle_pct": 30})
        waiting = []
        with frozen(bench, 0.350):
            time.sleep(0.05)
            c = bench.client
            if number % 2:
                params = c.demand_params(bench.source, throttle_pct=30)
                waiting.append(c.line("demand.set", **params))
            if number % 3 == 0:
                waiting.append(c.line("disarm"))
            c.write(*waiting)
        ended = time.monotonic()
        for _ in waiting:
            c.answer()
        bench.rest(0.12)
        frames = bench.commands(ended)
        why = bench.why()
        late = why["mode"] == "fault" and "tick" in why["latch"]["reason"]
        return late and all(f.data == wire.ZERO_TORQUE for f in frames)

    right = bench.of_ten(latched, still_s=0.350 + 0.050)
    figures.append(f"350 ms still while driving: latched, and no torque after {right} of 10")
    assert right == 10


def test_a_tick_less_than_four_periods_late_goes_on(bench):
    bench.drive(throttle_pct=30)
    bench.demand(throttle_pct=30)
    with frozen(bench, 0.130):
        pass
    bench.rest(0.2)
    assert bench.mode() == "active"
    assert bench.command().throttle == wire.percent(30)
