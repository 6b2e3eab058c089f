"""A pedal node that is gone, and one that is pressed before its gateway is there: 92, 93."""

import time
from collections.abc import Iterator

import pytest

from tests.faults.conftest import Seen
from tests.vcan.conftest import COMMANDS, Stand, ended_after, wait_until
from tests.vcan.pedal_node import MS, PRESSED, RELEASED, SLACK_MS, PedalDrive, configured, followed
from tests.vcan.test_api import begin
from vcu_gateway.client import RefusedError

EXPIRES_MS = 60  # three periods of 20 ms


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PedalDrive]:
    with ended_after(Stand(tmp_path_factory.mktemp("pedals"), forking=True)) as stand:
        yield begin(stand, configured(stand.folder), kind=PedalDrive)


def no_throttle_until_armed_with_released_pedals(drive: PedalDrive, since_ns: int) -> None:
    """Pressed, then released, it gives none; armed, it does."""
    with drive.client as client:
        wait_until(lambda: client.why()["mode"] == "standby", "standby")
        with pytest.raises(RefusedError):
            client.arm()
        drive.press(RELEASED)
        time.sleep(0.3)  # longer than `arm` wants them released: nothing else is missing
        drive.press(PRESSED)
        time.sleep(0.2)  # four ticks that could have throttle
        assert client.why()["mode"] == "standby"
    assert {f.data[1] for f in drive.recording.commands() if f.stamp_ns > since_ns} == {0}
    drive.until_driving()


def test_f92_an_unplugged_pedal_node_ends_the_drive_until_it_is_armed_again(
    drive: PedalDrive, seen: Seen
):
    drive.until_driving()
    drive.press(None)
    time.sleep(0.3)  # longer than the bound
    last = drive.pedal_frames()[-1]
    reactions = []
    for can_id in COMMANDS:
        own = [frame for frame in drive.recording.commands() if frame.can_id == can_id]
        took_ms, period_ms = followed(last, own, throttle=False)
        assert EXPIRES_MS <= took_ms <= EXPIRES_MS + period_ms + SLACK_MS
        reactions.append(took_ms)
    drive.press(PRESSED)
    since_ns = last.stamp_ns + round(max(reactions) * MS)
    no_throttle_until_armed_with_released_pedals(drive, since_ns)
    seen(
        f"throttle 0 after {max(reactions):.0f} ms; plugged in again and pressed: none until armed",
        max(reactions),
    )


def test_f93_a_gateway_restarted_with_a_pressed_pedal_has_no_throttle_until_armed(
    drive: PedalDrive, seen: Seen
):
    drive.until_driving()
    assert drive.gateway.stop() == 0
    since_ns = drive.recording.commands()[-1].stamp_ns
    drive.gateway = drive.stand.gateway(configured(drive.stand.folder))
    drive.until_ready()
    no_throttle_until_armed_with_released_pedals(drive, since_ns)
    seen("the pedal pressed all the time: no throttle before it was released and armed")
