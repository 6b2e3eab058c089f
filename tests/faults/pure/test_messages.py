"""Wrong frames and wrong codes, into the whole gateway in simulated time: faults 1 to 30."""

import dataclasses
import itertools
import json
import math
import random
import subprocess
import sys
from typing import Any

import pytest

from tests.core.simulated_drive import (
    CODEC,
    MS,
    POWER_CUT,
    RECEIVED,
    ZERO_TORQUE,
    Drive,
    active,
    data,
    standby,
)
from tests.driven import driven
from tests.faults.conftest import Seen
from tests.faults.judged_bus import is_safe
from tests.faults.line_client import LineClient
from tests.faults.machine import resident_kb
from vcu_gateway import config as configuration
from vcu_gateway.core.codec import Reason
from vcu_gateway.core.demand import ControllerDemand, PowerMode, Refusal
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.state import Quality
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.errors import ConfigError, DataError
from vcu_gateway.protocol import definition, packaged

STATUS = "BMS_Status"
THROTTLE = ControllerDemand(throttle_pct=40, power_mode=PowerMode.TURBO, regen_brake=True)
ID_OF = {name: CODEC.by_name[name].spec.can_id for name in RECEIVED}
COMMANDS = ("VCU_PCU1_Command", "VCU_PCU2_Command")
# Nine tenths of the traffic, and nothing here depends on it.
QUIET = {name for name in RECEIVED if name.startswith(("IMU", "ARD2"))}


def driving(asked: ControllerDemand = THROTTLE, **settings) -> Drive:
    """A drive in ACTIVE that has had a second to reach what is asked."""
    drive = active(**settings)
    drive.silent |= QUIET
    drive.demanded = asked
    drive.run(1000)
    assert drive.mode is Mode.ACTIVE, drive.sentence
    return drive


def until_safe_ms(drive: Drive, within_ms: int) -> float:
    """Tick until both frames are safe: simulated time from now."""
    from_ns = drive.now_ns
    for _ in range(within_ms // 50):
        drive.tick()
        if all(map(is_safe, drive.commands)):
            return (drive.now_ns - from_ns) / MS
    raise AssertionError(f"not safe within {within_ms} ms: {drive.sentence}")


@pytest.mark.parametrize("length", range(8))
def test_f01_a_short_frame_is_counted_and_not_decoded_and_the_last_value_ages(length, seen: Seen):
    drive = driving()
    receiver = drive.gateway.receiver
    before = receiver.store._latest.copy()
    for name in (*RECEIVED, *COMMANDS):
        frame = Frame(CODEC.by_name[name].spec.can_id, b"\xff" * length, drive.now_ns)
        receiver.receive(dataclasses.replace(frame, own_echo=name in COMMANDS))
    assert receiver.store._latest == before
    assert receiver.rejected[Reason.SHORT] == len(RECEIVED) + len(COMMANDS)
    last_ns = before[STATUS].arrival_ns
    drive.silent.add(STATUS)
    while drive.now_ns - last_ns < 1550 * MS:
        receiver.receive(Frame(ID_OF[STATUS], bytes(length), drive.now_ns))
        drive.tick()
        assert drive.mode is Mode.ACTIVE
    until_safe_ms(drive, 300)
    short = receiver.rejected[Reason.SHORT]
    seen(
        f"{short} frames of {length} bytes counted; zero torque once stale",
        reaction_ms=(drive.now_ns - last_ns) / MS,
    )
    assert (drive.now_ns - last_ns) / MS <= 1650
    assert drive.mode is Mode.FAULT


def test_f02_a_frame_that_is_too_long_is_counted_and_its_bytes_count_not_its_length_code(
    tmp_path, seen: Seen
):
    drive = driving()
    receiver = drive.gateway.receiver
    before = receiver.store._latest.copy()
    lengths = (*range(9, 17), 20, 24, 32, 48, 64)
    for name in RECEIVED:
        for length in lengths:
            receiver.receive(Frame(ID_OF[name], b"\xff" * length, drive.now_ns))
    assert receiver.store._latest == before
    assert receiver.rejected[Reason.LONG] == len(RECEIVED) * len(lengths)
    with driven(tmp_path) as whole:
        counted = _sent_through_the_connection(whole)
    assert counted == {"long": 2, "short": 0}
    seen(f"{receiver.rejected[Reason.LONG]} long frames counted; length codes 9 to 15 are 8 bytes")


def _sent_through_the_connection(whole) -> dict[str, int]:
    """FD frames, and eight bytes under every length code above 8."""
    import can

    receiver = whole.loop.gateway.receiver
    whole.until(lambda: "BMS_Temperatures" in receiver.store._latest, "the vehicle")
    message: dict[str, Any] = {"arbitration_id": ID_OF["BMS_Temperatures"], "is_extended_id": True}
    temperatures = receiver.store._latest["BMS_Temperatures"]
    for length in (12, 64):
        whole.other_node.send(can.Message(**message, data=bytes(length), is_fd=True))
    for code in range(9, 16):
        whole.other_node.send(can.Message(**message, data=bytes(range(8)), dlc=code))

    def taken() -> bool:
        latest = receiver.store._latest["BMS_Temperatures"]
        return latest.frame_count >= temperatures.frame_count + 7

    whole.until(taken, "seven frames of eight bytes")
    assert whole.loop.connection.counters.receiver_bugs == 0
    whole.until_mode("standby")  # a machine that stands still leaves it for a while
    rejected = receiver.rejected
    return {"long": rejected[Reason.LONG], "short": rejected[Reason.SHORT]}


def test_f07_another_priority_is_the_same_message_and_never_another(seen: Seen):
    drive = driving()
    receiver = drive.gateway.receiver
    for name in RECEIVED:
        for priority in range(8):
            can_id = ID_OF[name] & 0x03FF_FFFF | priority << 26
            before = {one: latest.frame_count for one, latest in receiver.store._latest.items()}
            receiver.receive(Frame(can_id, data(name), drive.now_ns))
            after = {one: latest.frame_count for one, latest in receiver.store._latest.items()}
            assert after == before | {name: before.get(name, 0) + 1}
    assert sum(receiver.rejected.values()) == 0
    seen(f"{8 * len(RECEIVED)} frames with priorities 0 to 7: each taken as its own message")


@pytest.mark.parametrize("flags", [0x2000_0000, 0x4000_0000, 0x8000_0000, 0xE000_0000])
def test_f09_an_identifier_with_flag_bits_is_refused_with_file_and_line(
    flags, tmp_path, seen: Seen
):
    wrong = flags | ID_OF[STATUS]
    config = tmp_path / "gateway.yaml"
    config.write_text(f"protocol:\n  aliases:\n    0x{wrong:08X}: IMU_Attitude\n")
    with pytest.raises(ConfigError) as refused:
        configuration.load(config)
    assert f"{config}:3" in str(refused.value)

    rows = tmp_path / "vcu.yaml"
    text = packaged("vcu.yaml").read_text()
    assert text.count("0x1808D0F4") == 1
    rows.write_text(text.replace("0x1808D0F4", f"0x{wrong:08X}"))
    with pytest.raises(DataError) as wrong_definition:
        definition.load(rows)
    line = text[: text.index("0x1808D0F4")].count("\n") + 1
    assert f"{rows}:{line}" in str(wrong_definition.value)

    log = tmp_path / "drive.log"
    good = f"(1700000000.000000) can0 {ID_OF[STATUS]:08X}#{data(STATUS).hex()}"
    log.write_text(f"{good}\n(1700000000.5) can0 {wrong:08X}#{data(STATUS).hex()}\n{good}\n")
    done = subprocess.run(
        [sys.executable, "-m", "vcu_gateway", "decode", str(log)], capture_output=True, text=True
    )
    decoded = [json.loads(line) for line in done.stdout.splitlines()]
    assert [entry["message"] for entry in decoded] == [STATUS, STATUS]
    assert f"{log}:2: identifier {wrong:08X}" in done.stderr
    seen(f"0x{wrong:08X}: configuration, definition and recording named with file and line")


def test_f10_a_million_unknown_identifiers_are_counted_and_nothing_grows(seen: Seen):
    drive = driving()
    receiver = drive.gateway.receiver
    chance = random.Random(10)
    known = {*ID_OF.values(), 0x08F02DE2, *(CODEC.by_name[name].spec.can_id for name in COMMANDS)}
    ours = {can_id & 0x03FF_FFFF for can_id in known}
    frames = [Frame(can_id, bytes(8), drive.now_ns, extended=False) for can_id in range(2048)]
    extended = (chance.getrandbits(29) for _ in range(60_000))
    frames += [
        Frame(one, bytes(8), drive.now_ns) for one in extended if one & 0x03FF_FFFF not in ours
    ]
    counted = sum(receiver.rejected.values())
    events = len(drive.events)
    total = before_kb = 0
    while total < 1_000_000:
        before_kb = before_kb or resident_kb()
        for frame in frames:
            receiver.receive(frame)
        total += len(frames)
        drive.tick()
    grown_kb = resident_kb() - before_kb
    assert sum(receiver.rejected.values()) - counted == total
    assert grown_kb < 1024
    assert len(drive.events) == events, "nothing in the log"
    assert drive.mode is Mode.ACTIVE
    assert drive.commands[0][1] > 0
    seen(f"{total:,} frames counted, memory +{grown_kb} kB, no log line, the drive goes on")


def test_f12_frozen_values_under_a_living_signal_are_accepted(seen: Seen):
    drive = driving()
    drive.run(600_000)
    assert drive.mode is Mode.ACTIVE
    assert drive.commands[0][1] == 103
    seen("600 s of the same values: ACTIVE, full torque; a documented limit")


RESERVED = [
    (f"{STATUS}.DischargeOvercurrent", 3, "cut"),
    (f"{STATUS}.Overtemperature", 3, "cut"),
    (f"{STATUS}.Undertemperature", 3, "cut"),
    (f"{STATUS}.TemperatureImbalance", 3, "alarm"),
    *((f"PCU{n}_Status1.TemperatureProtectLevel", 3, "stop") for n in (1, 2)),
    *((f"PCU{n}_Status1.VoltageLevel", raw, "limits") for n in (1, 2) for raw in (0, 6, 7)),
]


def power_w(frame: bytes) -> int:
    return int.from_bytes(frame[6:8], "little")


@pytest.mark.parametrize(("signal", "raw", "worst"), RESERVED)
def test_f16_a_code_that_nobody_defined_is_the_worst_of_its_signal(signal, raw, worst, seen: Seen):
    drive = driving(dataclasses.replace(THROTTLE, throttle_pct=20, brake_pct=40))
    message, _, name = signal.partition(".")
    defined = CODEC.by_name[message].spec.signal(name)
    assert raw not in range(int(defined.raw_minimum), int(defined.raw_maximum) + 1)
    drive.codes = {signal: raw}
    drive.receive(message)
    drive.tick()
    frame = drive.commands[0]
    expected = {
        "cut": lambda: frame == POWER_CUT and drive.mode is Mode.FAULT,
        "stop": lambda: frame == ZERO_TORQUE and drive.mode is Mode.FAULT,
        "alarm": lambda: drive.mode is Mode.ACTIVE and frame[1] > 0,
        "limits": lambda: not frame[0] & 0x2C and frame[2] == 0 and power_w(frame) < 60_000,
    }[worst]
    assert expected(), frame.hex()
    assert len({bytes(one) for one in drive.commands}) == 1, "both controllers"
    seen(f"{signal} {raw}: {worst}, in the tick after the frame", reaction_ms=50)


def test_f18_a_fault_that_flickers_keeps_its_limit_without_a_sawtooth(seen: Seen):
    drive = driving(dataclasses.replace(THROTTLE, power_limit_w=60_000))
    signal = f"{STATUS}.CellUndervoltage"
    powers, throttles = [], []
    for tick in range(200):
        drive.codes = {signal: tick // 10 % 2}
        drive.tick()
        powers.append(power_w(drive.commands[0]))
        throttles.append(drive.commands[0][1])
    assert powers[0] == 60_000
    assert all(b <= a for a, b in itertools.pairwise(powers)), "a limit never rises"
    assert powers[-1] == 10_000
    assert set(throttles) == {103}
    assert drive.mode is Mode.ACTIVE
    drive.codes = {}
    drive.run(3000)
    assert power_w(drive.commands[0]) == 60_000, "and goes when it is over"
    seen("1 s on, 1 s off for 10 s: PowerLimit falls once to 10 kW and stays")


@pytest.mark.parametrize("fill", [0x00, 0xFE, 0xFF])
@pytest.mark.parametrize("name", RECEIVED)
def test_f19_codes_that_are_no_numbers_are_not_used_as_numbers(name, fill, seen: Seen):
    drive = driving()
    spec = CODEC.by_name[name].spec
    drive.silent.add(name)
    drive.gateway.receive(Frame(ID_OF[name], bytes([fill]) * 8, drive.now_ns))
    snapshot = drive.tick().snapshot
    refused = 0
    for signal in spec.signals:
        reading = snapshot.reading(name, signal.name)
        inside = signal.raw_minimum <= reading.raw <= signal.raw_maximum
        good = inside and reading.raw != signal.saturated_raw
        assert (reading.quality is Quality.GOOD) == good
        refused += not good
    assert snapshot.latest(name) is not None, "the message itself is there"
    if name == STATUS and fill:
        assert drive.commands == [POWER_CUT] * 2
    seen(f"{name} of {fill:02X}: {refused} of {len(spec.signals)} signals not used")


OUT_OF_RANGE = [
    ("BMS_Status.SOC", 102, "PackVoltage"),
    ("BMS_Status.PackVoltage", 65535, "SOC"),
    ("PCU1_Status2.MotorSpeed", 65535, "BatteryVoltage"),
]


@pytest.mark.parametrize(("signal", "raw", "other"), OUT_OF_RANGE)
def test_f20_a_value_out_of_its_range_is_told_and_the_rest_of_its_message_counts(
    signal, raw, other, seen: Seen
):
    drive = driving()
    message, _, name = signal.partition(".")
    marked = drive.gateway.receiver.store._latest[message].marked_count
    drive.codes = {signal: raw}
    drive.receive(message)
    snapshot = drive.tick().snapshot
    assert snapshot.reading(message, name).quality is Quality.OUT_OF_RANGE
    assert snapshot.reading(message, other).quality is Quality.GOOD
    assert drive.gateway.receiver.store._latest[message].marked_count > marked
    assert [event for event in drive.events if signal in str(event.fields)], "an alarm"
    assert drive.mode is Mode.ACTIVE
    seen(f"{signal} of {raw}: alarm, not used; {other} is good and the drive goes on")


WRONG = (".nan", ".inf", "-.inf", "1.0e+308", "1" + "0" * 400)


def test_f21_numbers_that_are_none_are_refused_at_every_door(tmp_path, seen: Seen):
    keys = _numeric_keys()
    for section, key in keys:
        for wrong in WRONG:
            with pytest.raises(ConfigError) as refused:
                configuration.parse(f"{section}:\n  {key}: {wrong}\n", "gateway.yaml")
            assert "gateway.yaml:2" in str(refused.value), (key, wrong)
    drive = driving()
    names = ("throttle_pct", "brake_pct", "speed_limit_rpm", "power_limit_w")
    for name in names:
        for value in (math.nan, math.inf, -math.inf, 1e308, 10**400):
            changed: dict[str, Any] = {name: value}
            answer = drive.offer(dataclasses.replace(THROTTLE, **changed))
            assert answer.refusal in (Refusal.NOT_FINITE, Refusal.OUT_OF_RANGE)
    with driven(tmp_path) as whole:
        whole.until_ready()
        with LineClient(whole.socket_path) as client:
            texts = ("NaN", "Infinity", "-Infinity", "1e308", "1e999", "1" + "0" * 400)
            answers = [_refusal(client, name, text) for name in names for text in texts]
        assert whole.throttles() == {0}
    seen(
        f"{len(keys) * len(WRONG)} values in {len(keys)} keys refused with their line;"
        f" demands: not_finite, out_of_range; through the socket: {', '.join(sorted(set(answers)))}"
    )


def _numeric_keys() -> list[tuple[str, str]]:
    schema = configuration.schema()
    found = []
    for section, entry in schema["properties"].items():
        named = schema["$defs"].get(str(entry.get("$ref", "")).rpartition("/")[2], {})
        for key, value in named.get("properties", {}).items():
            if value.get("type") in ("number", "integer"):
                found.append((section, key))
    assert len(found) >= 10
    return found


def _refusal(client: LineClient, name: str, text: str) -> str:
    answer = client.line(
        b'{"jsonrpc":"2.0","id":1,"method":"demand.set","params":{"source":"x","sequence":1,'
        b'"ttl_ms":200,"values":{"%s":%s}}}' % (name.encode(), text.encode())
    )
    data = answer["error"].get("data") or {}
    return str(data.get("refusal", answer["error"]["message"]))


def test_f25_brake_and_throttle_together_take_the_throttle_until_it_is_released(seen: Seen):
    drive = driving()
    assert drive.commands[0][1] > 100
    drive.demanded = dataclasses.replace(THROTTLE, throttle_pct=60, brake_pct=10)
    drive.tick()
    assert {frame[1] for frame in drive.commands} == {0}
    drive.demanded = dataclasses.replace(THROTTLE, throttle_pct=60)
    drive.run(2000)
    assert {frame[1] for frame in drive.commands} == {0}, "the brake is released"
    drive.demanded = dataclasses.replace(THROTTLE, throttle_pct=5)
    drive.run(500)
    assert {frame[1] for frame in drive.commands} == {0}, "5 % is not less than 5 %"
    drive.demanded = dataclasses.replace(THROTTLE, throttle_pct=4.9)
    drive.tick()
    drive.demanded = THROTTLE
    drive.run(1000)
    assert {frame[1] for frame in drive.commands} == {103}
    assert drive.mode is Mode.ACTIVE
    seen("throttle 0 in the same tick and for 2.5 s more, until 4.9 % was asked", reaction_ms=50)


@pytest.mark.parametrize("throttle_pct", [0.01, 1.0, 100.0])
def test_f26_throttle_at_arming_and_at_reset_is_refused(throttle_pct, seen: Seen):
    drive = standby()
    drive.demanded = dataclasses.replace(THROTTLE, throttle_pct=throttle_pct)
    drive.tick()
    armed = drive.arm()
    assert (armed.granted, drive.mode) == (False, Mode.STANDBY)
    assert "throttle" in armed.sentence
    drive.receive_foreign()
    drive.run(3000)
    assert drive.mode is Mode.FAULT
    reset = drive.reset()
    assert (reset.granted, drive.mode) == (False, Mode.FAULT)
    assert "throttle" in reset.sentence
    drive.demanded = ControllerDemand()
    drive.tick()
    assert drive.reset().granted
    drive.tick()
    assert drive.mode is Mode.STANDBY, "never to ACTIVE"
    seen(f"{throttle_pct} %: arm: {armed.sentence}; reset: {reset.sentence}")


def test_f27_reverse_at_speed_waits_with_throttle_0_until_both_motors_are_slow(seen: Seen):
    drive = driving(dataclasses.replace(THROTTLE, throttle_pct=20))
    speeds = [f"PCU{n}_Status2.MotorSpeed" for n in (1, 2)]
    drive.codes = dict.fromkeys(speeds, 3000)
    drive.run(200)
    drive.demanded = dataclasses.replace(THROTTLE, throttle_pct=20, motor_reverse=True)
    drive.tick()
    assert {(frame[1], frame[0] & 0x10) for frame in drive.commands} == {(0, 0)}
    drive.codes = {speeds[0]: 3000, speeds[1]: 0}
    drive.run(1000)
    assert {(frame[1], frame[0] & 0x10) for frame in drive.commands} == {(0, 0)}, "one still turns"
    drive.codes = dict.fromkeys(speeds, 6001)
    drive.run(1000)
    assert {(frame[1], frame[0] & 0x10) for frame in drive.commands} == {(0, 0)}, "not known"
    drive.codes = dict.fromkeys(speeds, 49)
    drive.run(1000)
    assert {(frame[1], frame[0] & 0x10) for frame in drive.commands} == {(51, 0x10)}
    seen("throttle 0 in the same tick; turned only with both below 50 rpm", reaction_ms=50)
