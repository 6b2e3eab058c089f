"""What the fault tests found beside the numbered faults."""

import threading

import pytest

from tests.core.simulated_drive import Drive
from tests.driven import driven
from tests.faults.pure.test_process import moving
from vcu_gateway import config as configuration
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.errors import ConfigError


def test_a_restart_while_rolling_backwards_keeps_the_direction():
    """ZERO_TORQUE has MotorReverse as last applied, says docs/safety.md; Status1 tells it."""
    drive = Drive()
    drive.codes = {f"PCU{n}_Status1.MotorReverse": 1 for n in (1, 2)}
    drive.codes |= {f"PCU{n}_Status2.MotorSpeed": 1000 for n in (1, 2)}
    drive.until(Mode.STANDBY)
    assert {frame[0] & 0x10 for frame in drive.commands} == {0x10}


@pytest.mark.clock
def test_a_reload_that_cannot_be_started_does_not_end_the_gateway(tmp_path, monkeypatch):
    """No memory, or no more threads: the vehicle must not stop for a reload."""
    start = threading.Thread.start
    refused = threading.Event()

    def refuse(thread: threading.Thread) -> None:
        if thread.name == "reload":
            refused.set()
            raise RuntimeError("can't start new thread")
        start(thread)

    with driven(tmp_path) as whole, moving(whole):
        monkeypatch.setattr(threading.Thread, "start", refuse)
        whole.loop.work_queue.post(whole.api.reloader.begin)
        whole.until(refused.is_set, "the reload that cannot be started")
        ticks = whole.loop.schedule.ticks
        whole.until(lambda: whole.loop.schedule.ticks > ticks + 3, "further ticks")


def test_a_default_time_to_live_above_the_longest_is_refused():
    """Every demand without ttl_ms would be refused."""
    with pytest.raises(ConfigError):
        configuration.parse("demand: {ttl_max_ms: 100, ttl_default_ms: 200}\n", "gateway.yaml")
