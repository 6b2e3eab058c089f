"""Killed while it drives: what the bus hears of it, and how it comes back."""

import statistics

import pytest

from tests.faults.driving import MS, ZERO_TORQUE
from tests.service.driver import Driver, gaps_ms
from tests.service.unit import Signalled, Unit
from tests.vcan.conftest import COMMANDS, Recorded
from vcu_gateway.client import RefusedError

NARROWEST_MS, PERIOD_MS = 25, 50
# A fresh interpreter and 50 ms; in a busy lab the interpreter alone takes up to a second.
SAFE_WITHIN_MS = 2000


def test_a_kill_is_answered_by_zero_torque_of_a_fresh_process_and_an_unarmed_restart(
    service: Unit, driver: Driver, figures: list[str]
):
    driver.drive()
    last_ns = driver.commands()[-3].stamp_ns
    killed = service.kill()
    service.until_restarted()
    safe = frames_between(service, driver, killed)
    assert len(safe) >= 6
    narrowest_ms = min(gaps_ms(driver.commands(last_ns)))
    first_ms = (safe[0].stamp_ns - killed.asked_ns) / MS
    back_ms = (service.stamp_ns("ActiveEnter") - killed.asked_ns) / MS
    figures.append(
        f"kill: {len(safe)} safe frames from {first_ms:.0f} ms on, none less than"
        f" {narrowest_ms:.1f} ms after the last; READY again after {back_ms:.0f} ms"
    )
    assert {frame.can_id for frame in safe} == set(COMMANDS)
    assert {frame.data for frame in safe} == {ZERO_TORQUE}
    assert first_ms <= SAFE_WITHIN_MS
    assert narrowest_ms >= NARROWEST_MS
    assert statistics.median(gaps_ms(safe)) == pytest.approx(PERIOD_MS, rel=0.3)
    driver.until_standby()
    driver.until_zero_torque_alone(service.stamp_ns("ExecMainStart"))
    assert driver.mode() != "active", "the driver still holds the pedals"
    assert "restarted_unexpectedly" in service.events()
    driver.drive()


def frames_between(unit: Unit, driver: Driver, killed: Signalled) -> list[Recorded]:
    """Those between the killed process and the next; it may still have sent until it was."""
    frames = driver.commands(killed.asked_ns, until_ns=unit.stamp_ns("ExecMainStart"))
    return [one for one in frames if one.stamp_ns > killed.done_ns or not one.data[1]]


def test_three_kills_end_arming_until_a_clean_restart(service: Unit, driver: Driver):
    for times in (1, 2, 3):
        service.kill()
        service.until_restarted(times)
    driver.take()
    with pytest.raises(RefusedError, match="restarted 3 times"):
        driver.client.arm()
    service.restart()
    driver.drive()


def test_the_safe_frames_keep_a_power_cut(service: Unit, driver: Driver):
    driver.until_standby()
    driver.client.estop()
    since_ns = driver.commands()[-1].stamp_ns
    cut = driver.until_commands(12, since_ns)[-1].data
    assert cut != ZERO_TORQUE
    killed = service.kill()
    service.until_restarted()
    safe = frames_between(service, driver, killed)
    assert {frame.data for frame in safe} == {cut}
