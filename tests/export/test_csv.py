"""CSV of a log and of a drive: a row each 50 ms, exact values, pairs side by side."""

import csv
import json
from decimal import Decimal
from pathlib import Path

import pytest

from tests.export.drives import record
from tests.export.logs import PROTOCOL, START_NS, Sent, by_cantools, random_frames, write_log
from vcu_gateway.core.state import deadlines
from vcu_gateway.export import csv_table
from vcu_gateway.export.formats import written_text
from vcu_gateway.export.source import ReadOptions, Selection, read
from vcu_gateway.time_window import Window

MS = 1_000_000
FRAMES = random_frames(2000, seed=3)


def table(name: Path, *patterns: str) -> list[dict[str, str]]:
    source = read(str(name), ReadOptions(Window(), lambda _: None, lambda *_: None))
    path = name.parent / "out.csv"
    with written_text(path) as out:
        csv_table.write(source, Selection(patterns), out)
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def rows(tmp_path_factory) -> list[dict[str, str]]:
    return table(write_log(tmp_path_factory.mktemp("csv") / "drive.log", FRAMES))


def test_a_row_stands_for_each_50_ms(rows):
    assert rows[0]["time"] == "2025-11-23 17:46:40.123"
    assert [row["seconds"] for row in rows[:3]] == ["0.000", "0.050", "0.100"]
    assert len(rows) == (FRAMES[-1].stamp_ns - START_NS) // (50 * MS) + 1


@pytest.mark.parametrize("message", PROTOCOL.messages, ids=lambda message: message.name)
def test_each_cell_is_what_cantools_decodes_of_the_latest_frame(rows, message):
    decoded = by_cantools(FRAMES)[message.name]
    stale_ns = deadlines(message, {}, {}).stale_after_ns
    for number, row in enumerate(rows):
        moment_ns = START_NS + number * 50 * MS
        latest = [one for one in decoded if one[0] <= moment_ns][-1:]
        for signal in message.signals:
            unit = f" [{signal.unit}]" if signal.unit else ""
            cell = row[f"{message.name}.{signal.name}{unit}"]
            if not latest or moment_ns - latest[0][0] > stale_ns:
                assert cell == ""
                continue
            value = latest[0][1][signal.name]
            if value in signal.names:
                assert cell == signal.names[value]
            else:
                assert abs(Decimal(cell) - Decimal(value)) <= Decimal("1e-9")


def test_what_was_commanded_stands_beside_what_the_controller_says(rows):
    heads = list(rows[0])
    for node in ("PCU1", "PCU2"):
        for command, answer in (
            (f"VCU_{node}_Command.Throttle [%]", f"{node}_Status1.Throttle [%]"),
            (f"VCU_{node}_Command.PowerMode", f"{node}_Status1.PowerMode"),
            (f"VCU_{node}_Command.SpeedLimit [rpm]", f"{node}_Status2.MotorSpeed [rpm]"),
        ):
            assert heads.index(answer) == heads.index(command) + 1


def test_a_value_is_gone_when_it_is_stale(tmp_path):
    frames = [
        Sent(START_NS, 0x0809D0A7, "PCU1_Status2", bytes(8)),
        *(Sent(START_NS + n * 100 * MS, 0x040AD092, "ARD2", bytes(8)) for n in range(8)),
    ]
    cells = [
        row["PCU1_Status2.MotorSpeed [rpm]"] for row in table(write_log(tmp_path / "a.log", frames))
    ]
    assert cells == ["0"] * 5 + [""] * (len(cells) - 5)


def test_only_what_is_asked_for_is_a_column(tmp_path):
    found = table(write_log(tmp_path / "a.log", FRAMES), "BMS_Status.SOC", "*MotorSpeed")
    assert list(found[0]) == [
        *("time", "seconds", "PCU1_Status2.MotorSpeed [rpm]", "PCU2_Status2.MotorSpeed [rpm]"),
        "BMS_Status.SOC [%]",
    ]


def test_a_drive_has_mode_causes_events_and_why_at_each_tick(tmp_path):
    drive = record(tmp_path / "drive")
    found = table(tmp_path / "drive", "Gateway*")
    assert len(found) == len(drive.results)
    assert [row["Gateway.Mode"] for row in found] == [one.mode.value for one in drive.results]
    names = ["; ".join(dict.fromkeys(event.name for event in one.events)) for one in drive.results]
    assert [set(row["Gateway.Events"].split("; ")) for row in found] == [
        set(one.split("; ")) for one in names
    ]
    fault = next(row for row in found if row["Gateway.Mode"] == "fault")
    assert "BMS_Status.CellUndervoltage: stop" in fault["Gateway.Causes"]
    assert fault["Gateway.Why"].startswith("fault; latched (driver): BMS_Status.CellUndervoltage 2")
    assert json.dumps(found[-1])
