"""Anything at all, millions of times."""

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.core.test_invariants import COUNTS, GatewayMachine
from tests.faults import random_frames
from tests.faults.conftest import Seen
from vcu_gateway.core.supervisor import Mode


@pytest.mark.parametrize(
    "frames",
    [
        pytest.param(200_000, marks=pytest.mark.ci),
        pytest.param(10_000_000, marks=[pytest.mark.slow, pytest.mark.timeout(3600)]),
    ],
)
def test_f78_random_frames_break_nothing_and_leave_nothing(frames, seen: Seen):
    ran = random_frames.run(frames, seed=78)
    alone = random_frames.receiver_rate()
    seen(f"{ran}; through the receiver alone {alone:,.0f} a second")
    assert ran.frames >= frames
    # Half of the rounds are hostile from their first frame: 19 to 21 % is what the others give.
    assert ran.active > 0.15 * ran.ticks, "it must drive, not only stand"
    # A short run ends while the allocator still grows to its size.
    assert ran.growth_kb < random_frames.GROWTH_MAX_KB * (1 if frames >= 5_000_000 else 4)


def test_f79_anything_in_any_order_keeps_the_invariants(seen: Seen):
    """A part of tests/core/test_invariants.py, where the whole of it runs."""
    COUNTS.clear()
    for _ in range(3):  # chance may leave it standing for most of one turn
        run_state_machine_as_test(
            GatewayMachine,
            settings=settings(
                max_examples=20,
                stateful_step_count=50,
                deadline=None,
                suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no finding
                print_blob=True,
            ),
        )
        if COUNTS["steps"] > 500 and COUNTS[Mode.ACTIVE] > 0.1 * COUNTS["ticks"]:
            break
    assert COUNTS["steps"] > 500
    assert COUNTS[Mode.ACTIVE] > 0.1 * COUNTS["ticks"]
    seen(
        f"{COUNTS['steps']} steps, {COUNTS['ticks']} ticks, {COUNTS['frames']} frames, the"
        " invariants after each; `make nightly` takes 100,000 steps and more"
    )
