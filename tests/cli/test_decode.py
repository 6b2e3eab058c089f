"""`vcu-gateway decode`, from the file to the text."""

import contextlib
import csv
import gzip
import importlib.util
import io
import json
import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import NamedTuple

import can
import pytest
from click.testing import CliRunner

from vcu_gateway import cli, text
from vcu_gateway.core.codec import Codec, compile_message
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.errors import GatewayError
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.recording.decoded import FORMATS, Tally
from vcu_gateway.recording.log import open_recording

PROTOCOL = dbc.load(packaged("vcu.dbc"))
CODEC = Codec(PROTOCOL)
START_S = 1_700_000_000.5
GATEWAY = Path(sys.executable).with_name("vcu-gateway")


class Ran(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def frames(self) -> list[dict]:
        return [json.loads(line) for line in self.out.splitlines()]

    @property
    def problems(self) -> list[str]:
        return [line for line in self.err.splitlines() if re.match(r"\S+(:| frame )\d+: ", line)]

    @property
    def summary(self) -> list[str]:
        lines = self.err.splitlines()
        starts = [n for n, line in enumerate(lines) if line.startswith("frames ")]
        return [line for line in lines[starts[0] :] if not line.startswith("error: ")]


def run(*arguments: str | Path, stdin: str | bytes | None = None) -> Ran:
    result = CliRunner().invoke(cli.group, ["decode", *map(str, arguments)], input=stdin)
    if isinstance(result.exception, GatewayError):
        told = "".join(f"error: {problem}\n" for problem in result.exception.problems)
        return Ran(result.exception.exit_code, result.stdout, result.stderr + told)
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Ran(result.exit_code, result.stdout, result.stderr)


def log(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "drive.log"
    path.write_text("".join(f"{line}\n" for line in lines))
    return path


def line(frame: str, number: int = 0) -> str:
    return f"(1700000000.{number:06d}) vcan0 {frame}"


ACCELERATION = "040AD079#A81EA91EAA1E0000"


# What is written


def test_a_frame_becomes_one_object_with_all_that_is_known_of_it(tmp_path):
    path = log(tmp_path, "(1700000000.123456) can0 1808D0F4#B81300005005C3CD R")
    ran = run(path)
    assert ran.code == 0
    assert ran.frames == [
        {
            "time": 1700000000.123456,
            "channel": "can0",
            "message": "BMS_Status",
            "signals": {
                "PackVoltage": {"value": 50.48, "unit": "V", "raw": 5048, "quality": "good"},
                "SOC": {"value": 80, "unit": "%", "raw": 80, "quality": "good"},
                "CellOvervoltage": named(1, "level1"),
                "CellUndervoltage": named(1, "level1"),
                "DischargeOvercurrent": named(0, "normal"),
                "TemperatureImbalance": named(3, "reserved", "out of range"),
                "Overtemperature": named(0, "normal"),
                "Undertemperature": named(0, "normal"),
                "VoltageImbalance": named(1, "level1"),
                "InternalFault": named(1, "level2"),
                "BatteryState": named(1, "charging"),
                "ErrorCode": {"value": 19, "unit": "", "raw": 19, "quality": "good"},
                "LifeSignal": {"value": 1, "unit": "", "raw": 1, "quality": "good"},
            },
        }
    ]
    assert ran.err.splitlines() == ["frames 1: decoded 1, not decoded 0", "  BMS_Status 1"]


def named(raw: int, name: str | None, quality: str = "good") -> dict:
    return {"value": raw, "unit": "", "raw": raw, "quality": quality, "name": name}


def test_a_code_without_a_name_has_null_for_a_name(tmp_path):
    ran = run(log(tmp_path, line("0808D0A7#0000000600000000"), line("0808D0A7#0000000300000000")))
    levels = [frame["signals"]["VoltageLevel"] for frame in ran.frames]
    assert levels == [named(6, None, "out of range"), named(3, "low_to_high")]


def test_a_saturated_wheel_speed_says_so(tmp_path):
    ran = run(log(tmp_path, line("040AD092#00000100FFFF0000")))
    signals = ran.frames[0]["signals"]
    assert (signals["WheelSpeedFL"]["value"], signals["WheelSpeedFL"]["quality"]) == (0.001, "good")
    assert signals["WheelSpeedFR"] == {
        "value": 65.535,
        "unit": "km/h",
        "raw": 65535,
        "quality": "saturated",
    }


def test_values_have_no_more_decimals_than_their_code_carries():
    for codec in CODEC.by_name.values():
        writer = FORMATS["jsonl"](codec.spec)
        rng = random.Random(codec.spec.name)
        for _ in range(200):
            data = rng.randbytes(8)
            written = json.loads(writer.text(0, None, codec.decode(data)), parse_float=Decimal)
            for spec in codec.spec.signals:
                part = written["signals"][spec.name]
                exact = part["raw"] * Decimal(repr(spec.factor)) + Decimal(repr(spec.offset))
                assert Decimal(part["value"]) == exact


def test_a_zero_has_no_sign():
    signals = (SignalSpec("S", 0, 8, -29, 29, factor=0.29, offset=-29),)
    codec = compile_message(MessageSpec("M", 0, "A", ("B",), None, signals))
    decoded = codec.decode(bytes([100, *bytes(7)]))
    assert decoded.values[0] < 0
    assert '"value": 0.0,' in FORMATS["jsonl"](codec.spec).text(0, None, decoded)


def test_a_signal_with_very_many_codes_keeps_a_bounded_number_of_texts():
    codec = CODEC.by_name["IMU_Attitude"]
    writer = FORMATS["jsonl"](codec.spec)
    for raw in range(0, 65536, 3):
        decoded = codec.decode(raw.to_bytes(2, "little") * 3 + bytes(2))
        written = json.loads(writer.text(0, "can0", decoded))
        assert {part["raw"] for part in written["signals"].values()} == {raw}
        assert all(len(kept) <= 8192 for kept in writer._kept)


def test_csv_says_what_json_says(tmp_path):
    rng = random.Random(7)
    frames = [
        line(f"{codec.spec.can_id:08X}#{rng.randbytes(8).hex()}", n)
        for n, codec in enumerate(CODEC.by_name.values())
    ]
    path = log(tmp_path, *frames)
    rows = list(csv.DictReader(io.StringIO(run(path, "--format", "csv").out)))
    expected = [
        {
            "time": f"{frame['time']:.6f}",
            "channel": "vcan0",
            "message": frame["message"],
            "signal": name,
            "value": str(part["value"]),
            "unit": part["unit"],
            "raw": str(part["raw"]),
            "quality": part["quality"],
            "name": part.get("name") or "",
        }
        for frame in run(path).frames
        for name, part in frame["signals"].items()
    ]
    assert rows == expected


def test_csv_quotes_what_would_break_it(tmp_path):
    path = log(tmp_path, '(1.5) a,"b 040AD079#0000000000000000')
    rows = list(csv.reader(io.StringIO(run(path, "--format", "csv").out)))
    assert rows[1][:4] == ["1.500000", 'a,"b', "IMU_Acceleration", "AccelerationX"]
    assert {len(row) for row in rows} == {9}


# Which frames are decoded


@pytest.mark.parametrize("identifier", ["040AD079", "1C0AD079", "000AD079", "1c0ad079"])
def test_the_acceleration_is_decoded_at_both_printed_priorities_and_any(tmp_path, identifier):
    ran = run(log(tmp_path, line(f"{identifier}#A81EA91EAA1E0000")))
    (frame,) = ran.frames
    assert frame["message"] == "IMU_Acceleration"
    assert [part["value"] for part in frame["signals"].values()] == [0.0, 0.01, 0.02]


def test_the_second_attitude_identifier_is_the_attitude_unless_switched_off(tmp_path):
    path = log(tmp_path, line("08F02DE2#0000000000000000"))
    assert [frame["message"] for frame in run(path).frames] == ["IMU_Attitude"]
    ran = run(path, "--no-alias")
    assert (ran.code, ran.frames) == (0, [])
    assert ran.summary[1:] == ["not decoded:", "  unknown 1", "    08F02DE2 1"]


def test_a_30_bit_identifier_is_an_error_frame_and_never_data(tmp_path):
    path = log(
        tmp_path,
        line("240AD079#0011223344556677"),
        line("240AD079#0011223344556677"),
        line("240BD079#0011223344556677"),
        line(ACCELERATION),
    )
    ran = run(path)
    assert ran.code == 0
    assert [frame["signals"]["AccelerationX"]["raw"] for frame in ran.frames] == [0x1EA8]
    says = "has bit 29 set, SocketCAN's error-frame flag; the source prints such 30-bit identifiers"
    says += " for the IMU (docs/protocol.md E2); on the wire it is"
    assert ran.problems == [
        f"{path}:1: identifier 240AD079 {says} 040AD079",
        f"{path}:3: identifier 240BD079 {says} 040BD079",
    ]
    assert ran.summary == [
        "frames 4: decoded 1, not decoded 3",
        "  IMU_Acceleration 1",
        "not decoded:",
        "  error 3",
    ]


def test_the_kernels_own_error_frames_need_no_explanation(tmp_path):
    ran = run(log(tmp_path, line("20000088#0000000000000000"), line("20000204#0000000000006080")))
    assert ran.summary[0] == "frames 2: decoded 0, not decoded 2"
    assert ran.problems == []


@pytest.mark.parametrize(
    ("identifier", "what"),
    [
        ("440AD079", "has bit 30 set, SocketCAN's flag of remote frames"),
        ("840AD079", "has bit 31 set, SocketCAN's flag of 29-bit identifiers"),
        ("A40AD079", "has bit 31 set, SocketCAN's flag of 29-bit identifiers"),
        (
            "C40AD079",
            (
                "has bit 30 set, SocketCAN's flag of remote frames"
                " and bit 31 set, SocketCAN's flag of 29-bit identifiers"
            ),
        ),
    ],
)
def test_flags_in_an_identifier_are_refused_with_an_explanation(tmp_path, identifier, what):
    path = log(tmp_path, *[line(f"{identifier}#0011223344556677")] * 2, line(ACCELERATION))
    ran = run(path)
    assert ran.problems == [f"{path}:1: identifier {identifier} {what}; on the wire it is 040AD079"]
    assert ran.summary[0] == "frames 1: decoded 1, not decoded 0; unreadable 2"


def test_only_the_first_ten_identifiers_are_explained(tmp_path):
    frames = [line(f"{0x240AD000 + n:08X}#0011223344556677") for n in range(30)]
    ran = run(log(tmp_path, *frames))
    assert len(ran.problems) == 10
    assert ran.summary == ["frames 30: decoded 0, not decoded 30", "not decoded:", "  error 30"]


def test_the_highest_identifiers_are_no_errors(tmp_path):
    ran = run(log(tmp_path, line("1FFFFFFF#0011223344556677"), line("7FF#0011223344556677")))
    assert ran.problems == []
    assert ran.summary[2:] == [
        "  unknown 1",
        "    1FFFFFFF 1",
        "  standard_id 1",
        "    7FF 1",
    ]


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        ("040AD079#R", "remote 1"),
        ("040AD079#R8", "remote 1"),
        ("040AD079#R8_F", "remote 1"),
        ("079#0011223344556677", "standard_id 1\n    079 1"),
        ("040AD079#", "short 1"),
        ("040AD079#00112233445566", "short 1"),
        ("040AD079#001122334455667788", "long 1"),
        ("040AD079##0" + "00" * 12, "long 1"),
        ("040AD079##1" + "00" * 64, "long 1"),
        ("040AD079##1" + "00" * 8, "fd 1"),
        ("040AD07A#0011223344556677", "foreign_source 1\n    040AD07A 1"),
        ("18FF0011#0011223344556677", "unknown 1\n    18FF0011 1"),
    ],
)
def test_what_is_not_decoded_is_counted_by_reason(tmp_path, frame, reason):
    ran = run(log(tmp_path, line(frame)))
    assert (ran.code, ran.out) == (0, "")
    assert "\n".join(ran.summary) == (
        f"frames 1: decoded 0, not decoded 1\nnot decoded:\n  {reason}"
    )


@pytest.mark.parametrize(
    "frame",
    [
        "040AD079#A81EA91EAA1E0000_E",
        "040AD079#A8.1E.A9.1E.AA.1E.00.00",
        "040ad079#a81ea91eaa1e0000 T",
        "040AD079#A81EA91EAA1E0000  R",
    ],
)
def test_every_way_in_which_candump_writes_a_frame_is_read(tmp_path, frame):
    assert run(log(tmp_path, line(frame))).frames == run(log(tmp_path, line(ACCELERATION))).frames


@pytest.mark.parametrize(
    ("stamp", "time"),
    [("1", 1.0), ("1.5", 1.5), ("1700000000.123456789", 1700000000.123457), ("0.000001", 1e-6)],
)
def test_stamps_of_any_precision_are_read(tmp_path, stamp, time):
    assert run(log(tmp_path, f"({stamp}) can0 {ACCELERATION}")).frames[0]["time"] == time


# Damage


DAMAGED = [
    "nonsense",
    "(1700000000.000000) vcan0",
    "(later) vcan0 040AD079#0011223344556677",
    "(-1.0) vcan0 040AD079#0011223344556677",
    "  vcan0  040AD079   [8]  00 11 22 33 44 55 66 77",
    line("040AD079#00112233445566777"),
    line("040AD079#0011223344556G77"),
    line("040AD079#R9"),
    line("040AD079##"),
    line("40AD079#0011223344556677"),
    line("0040AD079#0011223344556677"),
    line("FFF#0011223344556677"),
    "\x00\x01\x02",
    "(1700000000.000000) vcan0 040AD079#" + "00" * 10_000,
    "(١.٥) vcan0 040AD079#0011223344556677",
]


@pytest.mark.parametrize("damaged", DAMAGED)
def test_a_damaged_line_is_reported_and_does_not_end_the_reading(tmp_path, damaged):
    path = log(tmp_path, line(ACCELERATION), "", damaged, line(ACCELERATION))
    ran = run(path)
    assert ran.code == 0
    assert len(ran.frames) == 2
    assert [complaint.split(": ")[0] for complaint in ran.problems] == [f"{path}:3"]
    assert ran.summary[0] == "frames 2: decoded 2, not decoded 0; unreadable 1"


def test_bytes_that_are_no_text_damage_their_line_only(tmp_path):
    path = tmp_path / "drive.log"
    path.write_bytes(f"\ufeff{line(ACCELERATION)}\r\n".encode() + b"\xff\xfe\x80\n")
    ran = run(path)
    assert len(ran.frames) == 1
    assert ran.summary[0].endswith("unreadable 1")


def test_only_the_first_ten_damaged_lines_are_reported(tmp_path):
    path = log(tmp_path, *["nonsense"] * 25, line(ACCELERATION))
    ran = run(path)
    assert ran.problems[-1] == f"{path}:10: further damage is only counted"
    assert len(ran.problems) == 11
    assert ran.summary[0] == "frames 1: decoded 1, not decoded 0; unreadable 25"


def test_a_recording_without_one_readable_frame_is_wrong_data(tmp_path):
    path = log(tmp_path, "nonsense")
    ran = run(path)
    assert ran.code == os.EX_DATAERR
    assert ran.err.splitlines()[-1] == f"error: {path}: holds no frame that can be read"
    ran = run(log(tmp_path))
    assert ran.code == os.EX_DATAERR
    assert ran.err.splitlines()[-1].endswith("holds no frame that can be read; it is empty")


# Formats


def recorded(name: str) -> can.Message:
    can_id = PROTOCOL.message(name).can_id
    return next(one for one in recorded_messages() if one.arbitration_id == can_id)


def recorded_messages() -> list[can.Message]:
    rng = random.Random(3)
    return [
        can.Message(
            timestamp=START_S + n * 0.01,
            arbitration_id=message.can_id,
            data=rng.randbytes(8),
            channel=0,
        )
        for n, message in enumerate(PROTOCOL.messages * 3)
    ]


def written(path: Path, messages: list[can.Message]) -> Path:
    with can.Logger(path) as logger:
        for message in messages:
            logger(message)
    return path


def packed(path: Path) -> Path:
    target = path.with_name(path.name + ".gz")
    target.write_bytes(gzip.compress(path.read_bytes()))
    return target


def without_stamp(frames: list[dict]) -> list[dict]:
    return [{"message": frame["message"], "signals": frame["signals"]} for frame in frames]


SUFFIXES = ["log", "asc", "blf", "csv", "db", "trc"]  # mf4: test_mf4.py
TEXTS = ["log", "asc", "csv", "trc"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_decodes_to_the_same(tmp_path, suffix):
    messages = recorded_messages()
    expected = run(written(tmp_path / "expected.log", messages)).frames
    assert len(expected) == len(messages)
    path = written(tmp_path / f"drive.{suffix}", messages)
    found = run(path).frames
    assert without_stamp(found) == without_stamp(expected)
    for frame, message in zip(found, messages, strict=True):
        since = frame["time"] - found[0]["time"]
        assert since == pytest.approx(message.timestamp - START_S, abs=1e-3)


@pytest.mark.parametrize("suffix", [*TEXTS, "blf"])
def test_every_format_is_read_packed_too(tmp_path, suffix):
    path = written(tmp_path / f"drive.{suffix}", recorded_messages())
    assert run(packed(path)).frames == run(path).frames


@pytest.mark.parametrize("suffix", ["csv", "db", "blf"])
def test_the_stamps_are_kept(tmp_path, suffix):
    path = written(tmp_path / f"drive.{suffix}", recorded_messages())
    stamps = [frame["time"] for frame in run(path).frames]
    assert stamps[:2] == [START_S, START_S + 0.01]


@pytest.mark.parametrize("suffix", ["csv", "db"])
def test_a_format_without_channels_has_null_for_the_channel(tmp_path, suffix):
    path = written(tmp_path / f"drive.{suffix}", recorded_messages())
    assert {frame["channel"] for frame in run(path).frames} == {None}
    rows = csv.DictReader(io.StringIO(run(path, "--format", "csv").out))
    assert {row["channel"] for row in rows} == {""}


@pytest.mark.parametrize("suffix", ["asc", "csv", "db", "trc", "log"])
def test_no_format_decodes_a_30_bit_identifier(tmp_path, suffix):
    good, bad = recorded("IMU_Acceleration"), recorded("IMU_Acceleration")
    bad.arbitration_id |= 1 << 29
    path = written(tmp_path / f"drive.{suffix}", [good, bad, bad])
    ran = run(path)
    assert ran.code == 0
    assert [frame["message"] for frame in ran.frames] == ["IMU_Acceleration"]
    (complaint,) = ran.problems
    assert "identifier 240AD079 has bit 29 set" in complaint
    assert ran.summary[-1] == "  error 2"
    where = complaint.split(": ")[0]
    if suffix == "db":
        assert where == f"{path}, frame 2"
    else:
        place = int(where.removeprefix(f"{path}:"))
        assert "240ad079" in path.read_text().splitlines()[place - 1].lower()


@pytest.mark.parametrize("suffix", ["csv", "db"])
def test_no_format_decodes_flags_in_an_identifier(tmp_path, suffix):
    good, bad = recorded("IMU_Acceleration"), recorded("IMU_Acceleration")
    bad.arbitration_id |= 1 << 31
    ran = run(written(tmp_path / f"drive.{suffix}", [good, bad]))
    assert ran.summary[0] == "frames 1: decoded 1, not decoded 0; unreadable 1"
    assert "has bit 31 set" in ran.problems[0]


def test_a_number_that_is_no_identifier_at_all_is_unreadable(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text(
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
        "1.0,0x040AD079,1,0,0,8,AAAAAAAAAAA=\n"
        "1.0,-0x1,1,0,0,8,AAAAAAAAAAA=\n"
        "1.0,0x1040AD079,1,0,0,8,AAAAAAAAAAA=\n"
        "nan,0x040AD079,1,0,0,8,AAAAAAAAAAA=\n"
    )
    ran = run(path)
    assert ran.summary[0] == "frames 1: decoded 1, not decoded 0; unreadable 3"
    assert [complaint.split(": ", 1)[0] for complaint in ran.problems] == [
        f"{path}:3",
        f"{path}:4",
        f"{path}:5",
    ]


def test_a_database_row_that_is_no_frame_is_unreadable(tmp_path):
    path = written(tmp_path / "drive.db", recorded_messages())
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute("UPDATE messages SET ts = NULL WHERE rowid = 2")
        base.execute("UPDATE messages SET ts = 'inf' WHERE rowid = 3")
        base.execute("UPDATE messages SET arbitration_id = 'x' WHERE rowid = 4")
        base.commit()
    ran = run(path)
    good = len(recorded_messages()) - 3
    assert ran.summary[0] == f"frames {good}: decoded {good}, not decoded 0; unreadable 3"
    assert ran.problems[0] == (
        f"{path}, frame 2: time None or identifier {0x1808D0F4} is no number"
    )


@pytest.mark.parametrize("suffix", ["blf", "asc", "csv", "db"])
def test_remote_error_and_standard_frames_are_counted_in_every_format(tmp_path, suffix):
    kinds = [
        can.Message(arbitration_id=0x040AD079, is_remote_frame=True, dlc=8, timestamp=START_S),
        can.Message(is_error_frame=True, timestamp=START_S),
        can.Message(arbitration_id=0x79, is_extended_id=False, data=bytes(8), timestamp=START_S),
        can.Message(arbitration_id=0x040AD079, data=bytes(3), timestamp=START_S),
    ]
    ran = run(written(tmp_path / f"drive.{suffix}", kinds))
    assert (ran.code, ran.out) == (0, "")
    counted = {row.split()[0]: row.split()[1] for row in ran.summary[2:]}
    assert counted == {"remote": "1", "error": "1", "standard_id": "1", "079": "1", "short": "1"}


# Files that cannot be read


def test_a_damaged_line_of_another_text_format_ends_the_reading_where_it_is(tmp_path):
    path = written(tmp_path / "drive.csv", recorded_messages())
    lines = path.read_text().splitlines()
    lines[5] = "nonsense"
    path.write_text("\n".join(lines))
    ran = run(path)
    assert ran.code == os.EX_DATAERR
    assert len(ran.frames) == 4
    assert ran.summary[0] == "frames 4: decoded 4, not decoded 0"
    assert ran.err.splitlines()[-1] == (
        f"error: {path}:6: is damaged here, ValueError: "
        "not enough values to unpack (expected 7, got 1); nothing after this place was read"
    )


@pytest.mark.parametrize("suffix", ["blf", "db", "trc", "csv", "log.gz", "asc.gz", "blf.gz"])
def test_contents_of_another_kind_are_wrong_data(tmp_path, suffix):
    path = tmp_path / f"drive.{suffix}"
    path.write_bytes(b"this is no recording\nat all\n" * 9)
    ran = run(path)
    assert ran.code == os.EX_DATAERR
    assert ran.out == ""
    place = f"{path}:" if suffix in {"trc", "csv", "log.gz", "asc.gz"} else f"{path}, frame 1: "
    assert ran.err.splitlines()[-1].startswith(f"error: {place}")


@pytest.mark.parametrize("suffix", ["log", "csv", "asc"])
def test_a_packed_file_cut_short_is_read_up_to_there(tmp_path, suffix):
    messages = [m for _ in range(200) for m in recorded_messages()]
    path = packed(written(tmp_path / f"drive.{suffix}", messages))
    path.write_bytes(path.read_bytes()[:-2000])
    ran = run(path)
    assert ran.code == os.EX_DATAERR
    assert 0 < len(ran.frames) < len(messages)
    assert "is damaged here, EOFError: " in ran.err.splitlines()[-1]


@pytest.mark.parametrize("name", ["none.log", "none.db", "none.blf", "none"])
def test_a_file_that_is_not_there_cannot_be_read_and_is_not_made(tmp_path, name):
    ran = run(tmp_path / name)
    assert ran.code == os.EX_NOINPUT
    assert ran.err == f"error: {tmp_path / name}: cannot be read: No such file or directory\n"
    assert not (tmp_path / name).exists()


def test_a_disk_that_fails_while_reading_is_no_wrong_data(tmp_path, monkeypatch):
    path = log(tmp_path, line(ACCELERATION))

    def failing(self: io.TextIOWrapper, size: int) -> str:
        del self, size
        raise OSError(5, "Input/output error")

    with open_recording(str(path), print) as recording:
        monkeypatch.setattr(recording._lines, "_pieces", iter(partial(failing, None, 0), ""))
        with pytest.raises(GatewayError, match="cannot be read: Input/output error") as caught:
            list(recording)
    assert caught.value.exit_code == os.EX_NOINPUT


def test_a_directory_cannot_be_read(tmp_path):
    ran = run(tmp_path)
    assert (ran.code, ran.err) == (
        os.EX_NOINPUT,
        f"error: {tmp_path}: cannot be read: Is a directory\n",
    )


@pytest.mark.parametrize(
    ("name", "what"),
    [
        (
            "drive.pcap",
            ".pcap is no known format; known are .asc, .blf, .csv, .db, .log, .mf4, .trc",
        ),
        ("drive", "has no suffix to tell its format; known are .asc, "),
        ("drive.gz", "has no suffix to tell its format; known are .asc, "),
        ("drive.db.gz", ".db cannot be read packed; gunzip it first"),
    ],
)
def test_a_format_that_nobody_reads_is_refused(tmp_path, name, what):
    path = tmp_path / name
    path.write_bytes(b"x")
    ran = run(path)
    assert ran.code == os.EX_NOINPUT
    assert ran.err.startswith(f"error: {path}: {what}")


@pytest.mark.skipif(importlib.util.find_spec("asammdf") is not None, reason="it is installed")
def test_mf4_without_its_package_says_what_to_install(tmp_path):
    path = tmp_path / "drive.mf4"
    path.write_bytes(b"MDF     ")
    ran = run(path)
    assert ran.code == os.EX_UNAVAILABLE
    assert ran.err.endswith(
        "reading .mf4 needs the package asammdf; pip install 'vcu-gateway[mf4]'\n"
    )


# Options


def test_only_the_messages_asked_for_are_written(tmp_path):
    path = log(
        tmp_path,
        line(ACCELERATION),
        line("1808D0F4#0000000000000000"),
        line("1809D0F4#0000000000000000"),
    )
    ran = run(path, "--message", "BMS_Status", "--message", "BMS_Temperatures")
    assert [frame["message"] for frame in ran.frames] == ["BMS_Status", "BMS_Temperatures"]
    assert ran.summary == [
        "frames 3: decoded 2, not decoded 0, not asked for 1",
        "  BMS_Status 1",
        "  BMS_Temperatures 1",
    ]


def test_an_unknown_message_is_a_wrong_command_line(tmp_path):
    ran = run(log(tmp_path, line(ACCELERATION)), "--message", "IMU_Altitude")
    assert ran.code == 2
    assert 'no message IMU_Altitude; did you mean "IMU_Attitude"?' in ran.err


def test_another_dbc_decodes_other_messages(tmp_path):
    other = tmp_path / "other.dbc"
    other.write_text(
        'VERSION ""\nBU_: A B\n'
        'BO_ 2566844926 Weather: 8 A\n SG_ Wind : 0|8@1+ (0.5,-1) [0|0] "°,x" B\n'
    )
    path = log(tmp_path, line("18FEF1FE#0300000000000000"), line(ACCELERATION))
    ran = run(path, "--dbc", other)
    assert [(f["message"], f["signals"]["Wind"]["value"]) for f in ran.frames] == [("Weather", 0.5)]
    assert ran.summary[-1] == "    040AD079 1"
    rows = list(csv.DictReader(io.StringIO(run(path, "--dbc", other, "--format", "csv").out)))
    assert rows[0]["unit"] == "°,x"
    assert run(path, "--dbc", tmp_path / "none.dbc").code == os.EX_NOINPUT
    assert run(path, "--dbc", path).code == os.EX_DATAERR


def test_the_output_can_be_a_file(tmp_path):
    path, out = log(tmp_path, line(ACCELERATION)), tmp_path / "out.jsonl"
    out.write_text("old " * 1000)
    ran = run(path, "-o", out)
    assert (ran.code, ran.out) == (0, "")
    assert out.read_text() == run(path).out


def test_the_recording_is_never_the_output(tmp_path):
    path = log(tmp_path, line(ACCELERATION))
    before = path.read_bytes()
    (tmp_path / "link.log").symlink_to(path)
    assert run(path, "-o", tmp_path / "link.log").code == 2
    assert path.read_bytes() == before


@pytest.mark.parametrize("target", ["/dev/full", "nowhere/out.jsonl"])
def test_an_output_that_cannot_be_written_is_reported(tmp_path, target):
    path = log(tmp_path, line(ACCELERATION))
    ran = run(path, "-o", tmp_path / target)
    assert ran.code == os.EX_UNAVAILABLE
    assert f"{target}: cannot be written: No " in ran.err.splitlines()[-1]


def test_candump_text_is_read_from_standard_input():
    text = f"{line(ACCELERATION)}\nnonsense\n"
    ran = run("-", stdin=text)
    assert len(ran.frames) == 1
    assert ran.err.startswith("standard input:2: is no line of a candump log")


def test_a_closed_standard_input_cannot_be_read(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(GatewayError, match="standard input: is closed"):
        open_recording("-", print).__enter__()


# Many identifiers


def test_the_ten_most_frequent_unknown_identifiers_are_named(tmp_path):
    frames = [
        line(f"{0x18FF0000 + n:08X}#0011223344556677") for n in range(15) for _ in range(n + 1)
    ]
    ran = run(log(tmp_path, *frames))
    assert ran.summary == [
        "frames 120: decoded 0, not decoded 120",
        "not decoded:",
        "  unknown 120",
        *[f"    {0x18FF0000 + n:08X} {n + 1}" for n in range(14, 4, -1)],
        "    others 15",
    ]


def test_a_million_identifiers_are_counted_in_bounded_memory():
    tally = Tally()
    for can_id in range(1_000_000):
        tally.add(can_id)
        if can_id % 100 == 0:
            tally.add(0x1FFFFFFF)
    assert len(tally._counts) <= 4096
    shown = list(tally.lines(8))
    assert shown[0] == "1FFFFFFF at least 10000"
    assert sum(int(row.split()[-1]) for row in shown) == 1_010_000


# Progress, pipes and signals


def test_progress_is_shown_for_a_large_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(text, "_LOOK_EVERY", 10)
    monkeypatch.setattr(text, "_PROGRESS_EVERY_S", -1)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    path = log(tmp_path, *[line(ACCELERATION)] * 1000)
    with open_recording(str(path), print) as recording:
        assert len(list(recording.watched(text.Progress()))) == 1000
        assert recording.size_bytes == path.stat().st_size
    shown = capsys.readouterr().err.split("\r\033[K")
    assert shown[1].startswith(" ")
    assert shown[-2] == "100%, 1000 frames "


def test_a_reader_that_leaves_ends_it_quietly(tmp_path):
    path = log(tmp_path, *[line(ACCELERATION, n) for n in range(20_000)])
    pipe = f"{GATEWAY} decode {path} | head -n 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", pipe], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["message"] == "IMU_Acceleration"


def test_a_live_pipe_is_decoded_frame_by_frame_until_ctrl_c():
    with subprocess.Popen(
        [GATEWAY, "decode", "-"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        process.stdin.write(f"{line(ACCELERATION)}\n")
        process.stdin.flush()
        assert json.loads(process.stdout.readline())["message"] == "IMU_Acceleration"
        process.send_signal(signal.SIGINT)
        process.wait(30)
        told = process.stderr.read().split("\n")
        assert told[:2] == ["frames 1: decoded 1, not decoded 0", "  IMU_Acceleration 1"]
    assert process.returncode == 128 + signal.SIGINT


def test_the_help_shows_the_columns_and_the_reasons():
    text = run("--help").out
    assert "time,channel,message,signal,value,unit,raw,quality,name" in text
    assert "candump -L can0 | vcu-gateway decode -" in text
