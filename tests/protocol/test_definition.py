"""Each refusal of the generator, by breaking one thing in the real definition."""

import dataclasses
import re

import pytest

from vcu_gateway.errors import DataError, MissingInputError
from vcu_gateway.protocol import definition, packaged
from vcu_gateway.protocol.definition_model import parse_bits

TEXT = packaged("vcu.yaml").read_text(encoding="utf-8")


def refusals(text: str) -> list[str]:
    with pytest.raises(DataError) as caught:
        definition.parse(text, "vcu.yaml")
    return str(caught.value).splitlines()


def broken(old: str, new: str) -> str:
    assert TEXT.count(old) == 1, f"{old!r} stands {TEXT.count(old)} times"
    return TEXT.replace(old, new)


def line_of(text: str, beginning: str) -> int:
    lines = [n for n, line in enumerate(text.splitlines(), 1) if line.strip().startswith(beginning)]
    assert lines, beginning
    return lines[-1]


PLAIN = "write the plain number, without quotes, unit or leading zeros"
SOC = 'SOC: {bits: B5, unit: "%", minimum: 0, maximum: 100,'
COMMAND_ID = 'for_each: [PCU1, PCU2]\n    id: "0x0008{address}D0"'
MOTOR_SPEED = "{bits: B7-B8, unit: rpm, minimum: 0, maximum: 6000,"

ONE_THING_BROKEN = {
    "an identifier beyond 29 bits": (
        "id: 0x040AD079",
        "id: 0x240AD079",
        "IMU_Acceleration.id: 0x240AD079 does not fit 29 bits",
        "id: 0x240AD079",
    ),
    "a negative identifier": (
        "id: 0x040AD079",
        'id: "-1"',
        "IMU_Acceleration.id: -1 does not fit 29 bits",
        'id: "-1"',
    ),
    "an identifier that is no number": (
        "id: 0x040AD079",
        "id: 0x040AD07G",
        "IMU_Acceleration.id: '0x040AD07G' is no hexadecimal number",
        "id: 0x040AD07G",
    ),
    "an identifier that ends in another node's address": (
        "id: 0x1809D0F4",
        "id: 0x1809D0F5",
        "BMS_Temperatures.id: 0x1809D0F5 does not end in the address of BMS",
        "id: 0x1809D0F5",
    ),
    "a printed identifier of a node that the message is not made for": (
        "source_ids: {PCU2: PS is 168}",
        "source_ids: {PCU3: PS is 169}",
        "VCU_{node}_Command.source_ids.PCU3: PCU3 is not in for_each",
        "source_ids: {PCU3: PS is 169}",
    ),
    "an identifier addressed to another node": (
        "id: 0x1809D0F4",
        "id: 0x1809A7F4",
        "BMS_Temperatures.id: 0x1809A7F4 is not addressed to VCU",
        "id: 0x1809A7F4",
    ),
    "the same identifier twice": (
        "id: 0x1809D0F4",
        "id: 0x1808D0F4",
        "BMS_Temperatures.id: 0x1808D0F4 is taken by BMS_Status (priority does not count)",
        "id: 0x1808D0F4",
    ),
    "the same identifier at another priority": (
        "id: 0x1809D0F4",
        "id: 0x0408D0F4",
        "BMS_Temperatures.id: 0x0408D0F4 is taken by BMS_Status (priority does not count)",
        "id: 0x0408D0F4",
    ),
    "the same message name twice": (
        '"{node}_Status2":',
        '"PCU1_Status1":',
        "PCU1_Status1: the name PCU1_Status1 stands twice",
        '"PCU1_Status1":',
    ),
    "the same signal name twice": (
        "      VoltageLevel:",
        "      Throttle:",
        "{node}_Status1.signals.Throttle: the name Throttle stands twice in this message",
        "Throttle:",
    ),
    "a message name that no DBC has": (
        "  BMS_Temperatures:",
        "  BMS-Temperatures:",
        "BMS-Temperatures: is no DBC name (letters, digits, _, at most 32)",
        "BMS-Temperatures:",
    ),
    "a signal name that no DBC has": (
        SOC,
        SOC.replace("SOC", "StateOfChargeInPercentOfThePack_33"),
        (
            "BMS_Status.signals.StateOfChargeInPercentOfThePack_33: "
            "is no DBC name (letters, digits, _, at most 32)"
        ),
        "StateOfChargeInPercentOfThePack_33:",
    ),
    "overlapping signals": (
        "bits: B6[2-3]",
        "bits: B6[1-2]",
        "BMS_Status.signals.CellUndervoltage: overlaps CellOvervoltage at B6[1]",
        "CellUndervoltage:",
    ),
    "a factor of 0": (
        "factor: 0.0078125, unit: V",
        "factor: 0, unit: V",
        "{node}_Status2.signals.BatteryVoltage.factor: a factor of 0 loses the value",
        "BatteryVoltage:",
    ),
    "a factor beyond every number": (
        "factor: 0.0078125, unit: V, minimum: 0, maximum: 511.99",
        "factor: 1.0e+308, unit: V",
        "{node}_Status2.signals.BatteryVoltage.factor: the factor is too large",
        "BatteryVoltage:",
    ),
    "a maximum that the bits cannot hold": (
        MOTOR_SPEED,
        MOTOR_SPEED.replace("6000", "70000"),
        (
            "{node}_Status2.signals.MotorSpeed.maximum: 70000 does not fit the bits, "
            "which hold 0..65535"
        ),
        MOTOR_SPEED.replace("6000", "70000"),
    ),
    "a minimum that the bits cannot hold": (
        MOTOR_SPEED,
        MOTOR_SPEED.replace("minimum: 0", "minimum: -1"),
        "{node}_Status2.signals.MotorSpeed.minimum: -1 does not fit the bits, which hold 0..65535",
        "{bits: B7-B8, unit: rpm",
    ),
    "a range upside down": (
        MOTOR_SPEED,
        MOTOR_SPEED.replace("minimum: 0", "minimum: 6001"),
        "{node}_Status2.signals.MotorSpeed.minimum: no code lies in the range 6001..6000",
        "{bits: B7-B8, unit: rpm",
    ),
    "a range between two codes": (
        MOTOR_SPEED,
        MOTOR_SPEED.replace("minimum: 0, maximum: 6000", "minimum: 0.2, maximum: 0.8"),
        "{node}_Status2.signals.MotorSpeed.minimum: no code lies in the range 0.2..0.8",
        "{bits: B7-B8, unit: rpm",
    ),
    "a value code beyond the bits": (
        "0: [idle, idle]",
        "4: [idle, idle]",
        "BMS_Status.signals.BatteryState.values.4: 4 does not fit the bits, which hold 0..3",
        "4: [idle, idle]",
    ),
    "a saturated code beyond the bits": (
        "saturated_raw: 0xFFFF,\n         source_term: 輪速FL",
        "saturated_raw: 0x10000,\n         source_term: 輪速FL",
        (
            "ARD2_SteeringWheel.signals.WheelSpeedFL.saturated_raw: "
            "65536 does not fit the bits, which hold 0..65535"
        ),
        "{bits: B3-B4, factor: 0.001",
    ),
    "an unknown sender": (
        "sender: ARD2",
        "sender: ARD3",
        "ARD2_SteeringWheel.sender: unknown node ARD3",
        "sender: ARD3",
    ),
    "an unknown receiver": (
        'receivers: ["{node}"]',
        'receivers: ["{node}", GHOST]',
        "VCU_{node}_Command.receivers: unknown node GHOST",
        'receivers: ["{node}", GHOST]',
    ),
    "an unknown node in for_each": (
        COMMAND_ID,
        COMMAND_ID.replace("PCU2", "PCU3"),
        "VCU_{node}_Command.for_each: unknown node PCU3",
        "for_each: [PCU1, PCU3]",
    ),
    "an unknown signal group": (
        "use: [control_mode]\n    signals:\n      SpeedLimit",
        "use: [control_mode, colours]\n    signals:\n      SpeedLimit",
        "VCU_{node}_Command.use: unknown signal group colours",
        "use: [control_mode, colours]",
    ),
    "a node name that no DBC has": (
        "  IMU: {address: 0x79,",
        "  9X: {address: 0x99}\n  IMU: {address: 0x79,",
        "9X: is no DBC name (letters, digits, _, at most 32)",
        "9X:",
    ),
    "an address twice": (
        "  IMU: {address: 0x79,",
        "  GHOST: {address: 0xF4}\n  IMU: {address: 0x79,",
        "GHOST.address: 0xF4 is taken by BMS",
        "GHOST:",
    ),
    "an address that stands for all nodes": (
        "  IMU: {address: 0x79,",
        "  GHOST: {address: 0xFF}\n  IMU: {address: 0x79,",
        "nodes.GHOST.address: must be at most 253, not 255",
        "GHOST:",
    ),
    "an alias of an unknown message": (
        "message: IMU_Attitude, comment",
        "message: IMU_Altitude, comment",
        "0: unknown message IMU_Altitude",
        "- {id: 0x08F02DE2",
    ),
    "an alias beyond 29 bits": (
        "id: 0x08F02DE2,",
        "id: 0x28F02DE2,",
        "0: id 0x28F02DE2 does not fit 29 bits",
        "- {id: 0x28F02DE2",
    ),
    "an alias that is a message's own identifier": (
        "id: 0x08F02DE2,",
        "id: 0x1C0AD079,",
        "0: id 0x1C0AD079 is taken by IMU_Acceleration",
        "- {id: 0x1C0AD079",
    ),
    "an unknown key": (
        SOC,
        SOC.replace("unit", "unti"),
        'messages.BMS_Status.signals.SOC.unti: unknown key; did you mean "unit"?',
        "SOC:",
    ),
    "a missing key": (
        "    sender: ARD2\n",
        "",
        "messages.ARD2_SteeringWheel.sender: is missing",
        "ARD2_SteeringWheel:",
    ),
    "a period of 0": (
        "period_ms: 100",
        "period_ms: 0",
        "messages.ARD2_SteeringWheel.period_ms: must be more than 0 ms, not 0",
        "period_ms: 0",
    ),
    "a number in quotes": (
        "period_ms: 100",
        'period_ms: "100"',
        (
            'messages.ARD2_SteeringWheel.period_ms: must be a whole number in ms, not "100"; '
            + PLAIN
        ),
        'period_ms: "100"',
    ),
    "text for a factor": (
        "factor: 0.0078125, unit: V",
        "factor: 1/128, unit: V",
        (
            'messages.{node}_Status2.signals.BatteryVoltage.factor: must be a number, not "1/128"; '
            + PLAIN
        ),
        "BatteryVoltage:",
    ),
    "a limit that is no number": (
        MOTOR_SPEED,
        MOTOR_SPEED.replace("6000", ".nan"),
        "messages.{node}_Status2.signals.MotorSpeed.maximum: must be a finite number, not .nan",
        "{bits: B7-B8, unit: rpm",
    ),
    "a truth where a name is meant": (
        '0: ["off", no regenerative braking]',
        "0: [true, no regenerative braking]",
        (
            "signal_groups.control_mode.RegenBrake.values.0.0: must be text, not true;"
            " put it in quotes"
        ),
        "values: {0: [true, no regenerative braking]",
    ),
    "a list for a message": (
        "  BMS_Temperatures:\n    id: 0x1809D0F4",
        "  Extra: []\n  BMS_Temperatures:\n    id: 0x1809D0F4",
        "messages.Extra: must be a section with keys below it, not a list",
        "Extra: []",
    ),
    "an unknown byte order": (
        'byte_order: little\n    comment: "Steering',
        'byte_order: middle\n    comment: "Steering',
        'messages.ARD2_SteeringWheel.byte_order: must be one of little, big, not "middle"',
        "byte_order: middle",
    ),
    "the same key twice": (
        SOC,
        "SOC: {bits: B8}\n      " + SOC,
        (
            "messages.BMS_Status.signals.SOC: duplicate key, first defined in line <line before>;"
            " remove one of them"
        ),
        "SOC: {bits: B5",
    ),
    "no YAML at all": (
        "nodes:\n  VCU:",
        "nodes: [\n  VCU:",
        (
            "is not valid YAML: while parsing a flow sequence,"
            " expected ',' or ']', but got '<scalar>'"
        ),
        "BMS: {address",
    ),
}


@pytest.mark.parametrize(
    ("old", "new", "message", "at"), ONE_THING_BROKEN.values(), ids=ONE_THING_BROKEN.keys()
)
def test_one_broken_row_is_one_line_that_names_it(old, new, message, at):
    text = broken(old, new)
    line = str(line_of(text, at))
    message = message.replace("<line before>", str(int(line) - 1))
    assert refusals(text) == [f"vcu.yaml:{line}: {message}"]


def test_unquoted_off_is_a_name_as_in_the_configuration():
    text = broken('0: ["off", no regenerative', "0: [off, no regenerative")
    assert definition.parse(text).spec == definition.parse(TEXT).spec


@pytest.mark.parametrize("bits", ["B9", "B0", "B2-B1", "B5[0-8]", "B5[]", "5", "", "B5-B6[0-1]"])
def test_bits_that_no_frame_has_are_refused(bits):
    text = broken(SOC, SOC.replace("B5", f'"{bits}"'))
    assert refusals(text) == [
        (
            f"vcu.yaml:{line_of(text, 'SOC:')}: BMS_Status.signals.SOC.bits: "
            f"{bits!r} is not of the form B5, B1-B2, B6[2-3] or B8[7]"
        )
    ]


def test_every_broken_row_is_told_at_once():
    text = broken("id: 0x040AD079", "id: 0x240AD079").replace("sender: ARD2", "sender: ARD3")
    assert [line.split(": ", 1)[1] for line in refusals(text)] == [
        "ARD2_SteeringWheel.sender: unknown node ARD3",
        "IMU_Acceleration.id: 0x240AD079 does not fit 29 bits",
    ]


def test_a_row_used_by_several_messages_is_refused_once():
    text = TEXT.replace("factor: 0.39", "factor: 0.000", 1)
    assert refusals(text) == [
        (
            f"vcu.yaml:{line_of(text, 'factor: 0.000')}: "
            "control_mode.Throttle.factor: a factor of 0 loses the value"
        )
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"vcu.yaml: must be a mapping, key: value in each line, not empty$"),
        ("[1, 2]", r"vcu.yaml: must be a mapping, key: value in each line, not a list$"),
        (
            "name: &a x\nversion: *a",
            r"vcu.yaml:2: aliases \(\*a\) are not read here; write the value",
        ),
    ],
)
def test_a_file_that_is_something_else_is_refused(text, message):
    assert re.search(message, refusals(text)[0])


def test_a_file_that_cannot_be_read_is_missing_input(tmp_path):
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"name: \xe9\xff")
    for path, why in (
        (tmp_path / "none.yaml", ": there is no such file"),
        (tmp_path, ": is a directory, not a file"),
        (latin, ":1: is not UTF-8 text: byte 0xE9; save it as UTF-8"),
    ):
        with pytest.raises(MissingInputError, match=f"^{path}{why}$"):
            definition.load(path)


def test_the_second_controller_is_the_first_with_another_address():
    spec = definition.parse(TEXT).spec
    for kind in ("Status1", "Status2"):
        first, second = spec.message(f"PCU1_{kind}"), spec.message(f"PCU2_{kind}")
        assert second.can_id - first.can_id == 0xA8 - 0xA7
        assert (
            dataclasses.replace(second, name=first.name, can_id=first.can_id, sender=first.sender)
            == first
        )
    first, second = spec.message("VCU_PCU1_Command"), spec.message("VCU_PCU2_Command")
    assert second.can_id - first.can_id == (0xA8 - 0xA7) << 8
    assert (
        dataclasses.replace(second, name=first.name, can_id=first.can_id, receivers=first.receivers)
        == first
    )


def test_a_broadcast_identifier_needs_no_addressee():
    text = broken("id: 0x1809D0F4", "id: 0x18FF01F4")
    assert definition.parse(text).spec.message("BMS_Temperatures").can_id == 0x18FF01F4
    text = broken("id: 0x1809D0F4", "id: 0x1809FFF4")
    assert definition.parse(text).spec.message("BMS_Temperatures").can_id == 0x1809FFF4


def test_the_aliases_and_notes_are_read():
    read = definition.parse(TEXT)
    assert read.spec.aliases == {0x08F02DE2: "IMU_Attitude"}
    row, node = read.rows["IMU_Attitude"]
    assert (row.source_id, node) == ("0x240CD079 (0x08f02de2)", "")
    row, node = read.rows["PCU2_Status1"]
    assert row.source_ids == {node: "the same as controller 1, SA 168"}
    assert row.note.startswith("B1 to B3 are laid out as in the command")
    assert read.rows["PCU1_Status1"] == (row, "PCU1")
    assert "(LSB)" in read.file.readings[0]
    assert read.file.errata["E2"][0] == "30-bit identifiers"


@pytest.mark.parametrize(
    ("text", "little", "big"),
    [
        ("B1", (0, 8), (7, 8)),
        ("B8", (56, 8), (63, 8)),
        ("B1-B2", (0, 16), (7, 16)),
        ("B7-B8", (48, 16), (55, 16)),
        ("B1-B8", (0, 64), (7, 64)),
        ("B3-B3", (16, 8), (23, 8)),
        ("B6[2-3]", (42, 2), (43, 2)),
        ("B6[3-2]", (42, 2), (43, 2)),
        ("B8[7]", (63, 1), (63, 1)),
        ("B1[0]", (0, 1), (0, 1)),
        ("B2-B1", None, None),
        ("B1[8]", None, None),
        ("B1 ", None, None),
    ],
)
def test_bits_are_read_in_both_byte_orders(text, little, big):
    assert parse_bits(text, "little") == little
    assert parse_bits(text, "big") == big
