"""What an own definition may change, and what the gateway refuses, by name and identifier."""

from dataclasses import replace

import pytest

from tests.simulator.driving import drive
from vcu_gateway import config as configuration
from vcu_gateway.config.checks import check_protocol, load_protocol
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.errors import DataError
from vcu_gateway.protocol import cantools_dbc, dbc, definition, packaged
from vcu_gateway.protocol.dbc import REMEDY, unmet
from vcu_gateway.simulator.scenario import Scenario, ScenarioStart

TEXT = packaged("vcu.yaml").read_text(encoding="utf-8")
PROTOCOL = dbc.load(packaged("vcu.dbc"))
SIGNALS = [(message, signal) for message in PROTOCOL.messages for signal in message.signals]

MOTOR_SPEED = "      MotorSpeed:\n        {bits: B7-B8, unit: rpm"
COMMAND = '    period_ms: 50\n    byte_order: little\n    comment: "Command'
CONTROLLER_2 = "  PCU2: {address: 0xA8, comment: Motor controller 2}\n"
SPEED_LIMIT = "SpeedLimit: {bits: B5-B6, unit: rpm, minimum: 0, maximum: 12000"


def changed(*replaced: tuple[str, str]) -> str:
    text = TEXT
    for old, new in replaced:
        assert old in text, old
        text = text.replace(old, new)
    return text


def refusals(text: str) -> list[str]:
    with pytest.raises(DataError) as caught:
        definition.parse(text, "vcu.yaml")
    return [line.removesuffix(f"; {REMEDY}") for line in str(caught.value).splitlines()]


def line_of(text: str, part: str) -> int:
    return 1 + text[: text.index(part)].count("\n")


def told(protocol: ProtocolSpec) -> list[str]:
    return [problem.what for problem in unmet(protocol, lambda *_: "")]


def with_message(old: MessageSpec, *new: MessageSpec) -> ProtocolSpec:
    others = tuple(message for message in PROTOCOL.messages if message is not old)
    return replace(PROTOCOL, messages=(*others, *new))


def with_signal(message: MessageSpec, old: SignalSpec, *new: SignalSpec) -> ProtocolSpec:
    others = tuple(signal for signal in message.signals if signal is not old)
    return with_message(message, replace(message, signals=(*others, *new)))


def test_the_packaged_protocol_is_what_the_gateway_needs():
    assert told(PROTOCOL) == []


# Each line of the refusal, by the text whose line it names.
REFUSED = {
    "a message of another name": (
        [("  BMS_Status:\n", "  BMS_State:\n")],
        {
            "BMS_State:\n": "BMS_State (0x1808D0F4): is this BMS_Status? "
            "The gateway reads it by that name, and it is missing"
        },
    ),
    "no such message": (
        [(TEXT[TEXT.index("  BMS_Temp") : TEXT.index("  IMU_Acceleration:")], "")],
        {"messages:\n": "BMS_Temperatures: is missing, and the gateway reads it"},
    ),
    "a signal of another name": (
        [("      SOC: {bits", "      SOC_Pct: {bits")],
        {
            "SOC_Pct": "BMS_Status.SOC_Pct (0x1808D0F4): is this SOC? "
            "The gateway reads it by that name, and it is missing"
        },
    ),
    "a quantity in another unit": (
        [('AccelerationX: {bits: B1-B2, factor: 0.01, offset: -78.48, unit: m/s2',
          'AccelerationX: {bits: B1-B2, factor: 0.01, offset: -78.48, unit: g')],
        {"AccelerationX": "IMU_Acceleration.AccelerationX (0x040AD079): "
         "the unit must be m/s2, not g"},
    ),
    "a message at another period": (
        [("    period_ms: 100\n", "    period_ms: 200\n")],
        {"  ARD2_SteeringWheel:": "ARD2_SteeringWheel (0x040AD092): "
         "the period must be 100 ms, not 200 ms"},
    ),
    "a signal on bytes that are kept free": (
        [("      SOC: {bits", "      PackCurrent: {bits: B3-B4}\n      SOC: {bits")],
        {"PackCurrent: {": "BMS_Status.signals.PackCurrent: "
         "lies on B3-B4, which `reserved` keeps free in 0x1808D0F4"},
    ),
    "bits kept free that no frame has": (
        [("reserved: {B6-B8:", "reserved: {B6-B9:")],
        {"reserved: {B6-B9": "BMS_Temperatures.reserved.B6-B9: "
         "'B6-B9' is not of the form B5, B1-B2, B6[2-3] or B8[7]"},
    ),
    "a third controller": (
        [
            (CONTROLLER_2, f"{CONTROLLER_2}  PCU3: {{address: 0xA9, comment: A third}}\n"),
            ("for_each: [PCU1, PCU2]", "for_each: [PCU1, PCU2, PCU3]"),
        ],
        {'"VCU_{node}_Command":': "VCU_PCU3_Command (0x0008A9D0): "
         "VCU commands PCU1 and PCU2 and sends nothing else"},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("replaced", "expected"), REFUSED.values(), ids=REFUSED.keys())
def test_a_definition_that_the_gateway_cannot_run_with_is_refused_by_line(replaced, expected):
    text = changed(*replaced)
    wanted = [f"vcu.yaml:{line_of(text, part)}: {what}" for part, what in expected.items()]
    assert refusals(text) == wanted


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (COMMAND, COMMAND.replace("50", "20"), ": the period must be 50 ms, not 20 ms"),
        (
            SPEED_LIMIT,
            SPEED_LIMIT.replace("12000", "6000"),
            ".SpeedLimit: the maximum must be 12000, not 6000",
        ),
        (
            SPEED_LIMIT,
            SPEED_LIMIT.replace("unit", "factor: 0.5, unit"),
            ".SpeedLimit: the factor must be 1, not 0.5",
        ),
    ],
)
def test_the_commands_stay_as_they_are_in_both_messages(old, new, what):
    signal, _, rest = what.partition(": ")
    lines = [line.split(": ", 1)[1] for line in refusals(changed((old, new)))]
    expected = [f"VCU_PCU{n}_Command{signal} (0x0008A{6 + n}D0): {rest}" for n in (1, 2)]
    assert lines == expected


def test_a_command_laid_out_differently_or_with_one_signal_more_is_refused():
    command = PROTOCOL.message("VCU_PCU1_Command")
    power = command.signal("PowerLimit")
    moved = with_signal(command, power, replace(power, start_bit=24, length_bits=8))
    what = "must be the 16 bits from B7[0] on, unsigned"
    assert told(moved) == [f"VCU_PCU1_Command.PowerLimit (0x0008A7D0): {what}"]
    more = with_signal(command, power, power, SignalSpec("Horn", 24, 1, 0, 1))
    what = "a command has no further signal: its other bits are sent as 0"
    assert told(more) == [f"VCU_PCU1_Command.Horn (0x0008A7D0): {what}"]


@pytest.mark.parametrize("code", ["CellOvervoltage", "LifeSignal"])
def test_a_code_of_other_bits_or_scaled_is_refused(code):
    battery = PROTOCOL.message("BMS_Status")
    signal = battery.signal(code)
    highest = signal.raw_highest
    wider = with_signal(battery, signal, replace(signal, length_bits=4))
    what = f"the bits must hold the codes 0..{highest}, not 0..15"
    assert told(wider) == [f"BMS_Status.{code} (0x1808D0F4): {what}"]
    scaled = with_signal(battery, signal, replace(signal, factor=2.0))
    assert told(scaled) == [f"BMS_Status.{code} (0x1808D0F4): a code has factor 1 and offset 0"]


@pytest.mark.parametrize(
    "parties", [{"sender": "VCU"}, {"receivers": ("BMS",)}], ids=["from here", "to another"]
)
def test_a_message_that_does_not_reach_the_gateway_is_refused(parties):
    battery = PROTOCOL.message("BMS_Temperatures")
    found = told(with_message(battery, replace(battery, **parties)))
    assert found[0] == "BMS_Temperatures (0x1809D0F4): must come from another node to VCU"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"receivers": ("PCU1",)}, "must go to VCU, which reads nothing else: take it out"),
        ({"signals": ()}, "has no signal"),
    ],
)
def test_a_further_message_that_gives_the_gateway_nothing_is_refused(changes, what):
    battery = PROTOCOL.message("BMS_Temperatures")
    further = replace(battery, name="Own", can_id=0x1806A7F4)
    assert told(with_message(battery, battery, further)) == []
    found = told(with_message(battery, battery, replace(further, **changes)))
    assert found == [f"Own (0x1806A7F4): {what}"]


def test_every_message_of_the_table_is_needed_by_its_name():
    for message in PROTOCOL.messages:
        found = told(with_message(message, replace(message, name="Own")))
        assert found[0] == f"{message.name}: is missing, and the gateway reads it"


def test_every_signal_of_the_table_is_needed_by_its_name():
    for message, signal in SIGNALS:
        found = told(with_signal(message, signal))
        name = f"{message.name}.{signal.name} (0x{message.can_id:08X})"
        assert found == [f"{name}: is missing, and the gateway reads it"]


OWN = (
    ("id: 0x1808D0F4", "id: 0x18F00AF4"),
    ("BMS: {address: 0xF4", "BMS: {address: 0xF5"),
    ("F4\n    sender: BMS", "F5\n    sender: BMS"),
    (MOTOR_SPEED, MOTOR_SPEED.replace("unit", "factor: 0.5, unit")),
    ("    reserved: {B7-B8: \"\"}\n\n  BMS_Status", "\n  BMS_Status"),
    ("      WheelSpeedFL:", "      Extra: {bits: B7}\n      WheelSpeedFL:"),
    (
        "messages:\n",
        """messages:
  Charger:
    {id: 0x1806D0F5, sender: BMS, receivers: [VCU], period_ms: 1000, signals: {On: {bits: "B1[0]"}}}
""",
    ),
)  # fmt: skip


def test_an_own_identifier_scaling_message_and_signal_are_taken_and_driven():
    spec = definition.parse(changed(*OWN)).spec
    done = drive(Codec(spec), Scenario(ScenarioStart(), ()), 4)
    assert done.ticks[-1].mode is Mode.ACTIVE
    assert {frame.can_id for _, frame in done.heard_of("BMS_Status")} == {0x18F00AF5}
    assert done.heard_of("Charger")


def test_a_packaged_dbc_without_a_needed_message_is_refused_before_anything_starts():
    battery = PROTOCOL.message("BMS_Status")
    with pytest.raises(DataError) as caught:
        check_protocol(configuration.Config(), with_message(battery))
    what = "BMS_Status: is missing, and the gateway reads it"
    assert str(caught.value) == f"{packaged('vcu.dbc')}: {what}; {REMEDY}"


def refused(folder, text: str) -> list[str]:
    (folder / "own.dbc").write_text(text)
    (folder / "gateway.yaml").write_text("protocol: {dbc: own.dbc}\n")
    config = configuration.load(folder / "gateway.yaml")
    with pytest.raises(DataError) as caught:
        check_protocol(config, load_protocol(config))
    return str(caught.value).splitlines()


def test_a_configured_dbc_that_lets_the_gateway_send_more_is_refused(tmp_path):
    own = definition.parse(TEXT)
    further = replace(own.spec.message("VCU_PCU1_Command"), name="Own", can_id=0x0009A7D0)
    spec = replace(own.spec, messages=(*own.spec.messages, further))
    what = "Own (0x0009A7D0): VCU commands PCU1 and PCU2 and sends nothing else"
    text = cantools_dbc.write(own._replace(spec=spec))
    assert refused(tmp_path, text) == [f"{tmp_path}/own.dbc: {what}; {REMEDY}"]


def test_a_configured_dbc_of_another_identifier_is_refused_in_hexadecimal(tmp_path):
    text = cantools_dbc.write(definition.parse(changed(("id: 0x1809D0F4", "id: 0x18F001F4"))))
    what = "BMS_Temperatures (0x1809D0F4): identifier is 0x18F001F4, not 0x1809D0F4"
    remedy = f"`protocol.dbc` may add to the packaged DBC, not change it; {REMEDY}"
    assert refused(tmp_path, text) == [f"{tmp_path}/own.dbc: {what}; {remedy}"]


def test_the_dbc_of_another_vehicle_is_one_line(tmp_path):
    text = 'VERSION ""\nBU_: A B\nBO_ 2566844926 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|255] "" B\n'
    (line,) = refused(tmp_path, text)
    assert ": has none of this vehicle's messages: it is the DBC of something else; " in line
