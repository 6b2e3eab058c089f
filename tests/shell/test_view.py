"""The table: everything in 80 x 24, more where there is room, and no colour but on a terminal."""

import io
import re

import pytest
from rich.console import Console

from tests.conftest import payload
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.schedule import Schedule
from vcu_gateway.core.settings import Settings
from vcu_gateway.view import Picture, common_prefix, render

MS = 1_000_000


@pytest.fixture
def picture(codec):
    gateway = Gateway(codec, Settings(), 0)
    for at_ms, life in ((1000, 0), (1500, 1)):
        for message in codec.protocol.received_by("VCU"):
            values = {"SOC": 80, "PackVoltage": 52.5, "LifeSignal": life, "VoltageLevel": 3}
            data = payload(codec, message.name, values)
            gateway.intake.receive(Frame(message.can_id, data, at_ms * MS))
    gateway.intake.receive(Frame(0x18FECA15, bytes(8), 0))
    schedule = Schedule(0, 50 * MS)
    schedule.due(300_000)
    result = gateway.tick(1510 * MS)

    def make(**changes):
        facts = {
            "title": "vcu-gateway on vcan0",
            "why": gateway.why(1510 * MS),
            "snapshot": result.snapshot,
            "commands": result.commands,
            "frames": result.frames,
            "schedule": schedule,
            "sent": 42,
            "rejected": {r.value: n for r, n in gateway.intake.rejected.items()},
        } | changes
        return Picture(**facts)

    return make


def shown(picture: Picture, width: int, roomy: bool) -> list[str]:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(render(picture, roomy))
    return console.file.getvalue().splitlines()


def test_it_fits_a_terminal_of_80_by_24(picture):
    lines = shown(picture(), 80, roomy=False)
    assert len(lines) <= 24
    assert all(len(line) <= 80 for line in lines)
    text = "\n".join(lines)
    for words in ("vcu-gateway on vcan0", "starting", "PCU1_Status2", "safety", "sent 42"):
        assert words in text
    assert "rejected unknown 1" in text
    assert re.search(r"late p50 ≤ 0\.5 ms", text)


def test_with_room_every_signal_is_there_with_its_unit(picture):
    text = " ".join(" ".join(shown(picture(), 160, roomy=True)).split())
    assert "PackVoltage 52.50 V SOC 80 %" in text
    assert re.search(r"BMS_Status +10 +2\.0 ", text)
    assert "VoltageLevel low_to_high" in text


def test_what_never_came_is_told_as_never(codec, picture):
    silent = Gateway(codec, Settings(), 0).tick(0)
    text = "\n".join(shown(picture(snapshot=silent.snapshot, dropped=7), 140, roomy=False))
    assert text.count("never") >= 10
    assert "dropped by the kernel 7" in text


def test_a_controller_without_a_frame_is_silent(picture):
    assert sum("silent" in line for line in shown(picture(frames=()), 100, roomy=False)) == 2


@pytest.mark.parametrize(
    ("names", "prefix"),
    [
        (["AccelerationX", "AccelerationY"], "Acceleration"),
        (["PackTemperature1", "PackTemperature2"], "PackTemperature"),
        (["BatteryVoltage", "BatteryCurrent"], "Battery"),
        (["PackVoltage", "SOC"], ""),
        (["Alone"], ""),
    ],
)
def test_what_all_names_of_a_message_share_is_not_repeated(names, prefix):
    assert common_prefix(names) == prefix
