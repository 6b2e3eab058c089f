"""The gateway drives over a real controller; its interface goes down, comes up, is pulled out."""

import itertools
import statistics
import time

from tests.controller.conftest import GATEWAY, link
from tests.faults.driving import (
    MS,
    PERIOD_MS,
    Driving,
    first_frames_ms,
    measured,
    set_up,
    undisturbed,
)
from tests.vcan.conftest import COMMANDS, wait_until

RETURN_MS = 1000
FRAMES = 40


def test_it_drives_every_50_ms_and_its_own_frames_prove_that_they_left(
    driving: Driving, figures: list[str]
):
    def gaps_ms() -> list[float]:
        driving.until_driving()
        begun_ns = time.time_ns()
        wait_until(lambda: len(driving.commands(begun_ns)) > 2 * FRAMES, "command frames")
        frames = [one for one in driving.commands(begun_ns) if one.can_id == COMMANDS[0]]
        assert {frame.data[1] for frame in frames} == {driving.throttle_raw()}
        return [(b.stamp_ns - a.stamp_ns) / MS for a, b in itertools.pairwise(frames)]

    found = undisturbed(driving, gaps_ms)
    figures.append(
        f"{len(found)} gaps between commands on {GATEWAY}: median "
        f"{statistics.median(found):.1f} ms, {min(found):.1f} to {max(found):.1f} ms"
    )
    assert abs(statistics.median(found) - PERIOD_MS) < 1
    assert min(found) >= PERIOD_MS / 2
    health = driving.client.health()
    assert health["link"]["state"] == "up"
    assert driving.events("echo_unproven") == [], "the controller confirms what has left"
    sent = link(GATEWAY)["stats64"]["tx"]["packets"]
    assert health["frames"]["sent"] <= sent <= health["frames"]["sent"] + 4


def test_an_interface_that_goes_down_and_up_is_used_again_within_a_second_unarmed(
    driving: Driving, figures: list[str]
):
    def return_ms() -> float:
        driving.until_driving()
        down_ns = set_up(GATEWAY, up=False)
        driving.until_link("lost")
        driving.until_mode("fault")
        time.sleep(1)
        still_down_ns = time.time_ns()
        assert not driving.commands(down_ns, still_down_ns), "nothing leaves meanwhile"
        up_ns = set_up(GATEWAY)
        receiving_ms = (driving.until_receiving() - up_ns) / MS
        first_ms = first_frames_ms(driving, still_down_ns)
        assert driving.mode() == "fault", "latched: a reset and a new arming are needed"
        assert "is down" in str(driving.events("link_lost")[-1]["reason"])
        return max(first_ms, receiving_ms)

    found = measured(driving, RETURN_MS, return_ms)
    figures.append(f"{GATEWAY} down and up: in use again after {found[-1]:.0f} ms, fault")
    driving.until_driving()


def test_an_interface_that_was_down_for_a_moment_only_is_latched_all_the_same(driving: Driving):
    losses = len(driving.events("link_lost"))
    set_up(GATEWAY, up=False)
    up_ns = set_up(GATEWAY)
    driving.until_mode("fault")
    assert first_frames_ms(driving, up_ns) <= RETURN_MS
    wait_until(lambda: len(driving.events("link_lost")) > losses, "the word")
    driving.until_driving()
