"""The committed DBC against the definition, cantools and, typed by hand, docs/protocol.md."""

import hashlib
import subprocess
import sys

import cantools
import pytest
from scripts.documents import protocol_page

from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.errors import DataError, MissingInputError
from vcu_gateway.protocol import cantools_dbc, dbc, definition, packaged, vcu_dbc

DEFINITION = definition.load(packaged("vcu.yaml"))
DBC_PATH = packaged("vcu.dbc")
DBC_TEXT = DBC_PATH.read_text(encoding="utf-8")
REPOSITORY = packaged("vcu.yaml").resolve().parents[1]


def test_the_committed_dbc_is_what_the_definition_says():
    assert cantools_dbc.write(DEFINITION) == DBC_TEXT


def test_the_committed_page_is_what_the_definition_says():
    assert protocol_page.write(DEFINITION) == (REPOSITORY / "docs/protocol.md").read_text(
        encoding="utf-8"
    )


def test_the_dbc_says_all_that_the_definition_says():
    read = dbc.load(DBC_PATH)
    assert read.messages == DEFINITION.spec.messages
    assert read.nodes == DEFINITION.spec.nodes
    assert list(read.nodes) == list(DEFINITION.spec.nodes)


def test_the_module_holds_every_field_that_cantools_reads():
    read = cantools_dbc.parse(DBC_TEXT)
    assert read == vcu_dbc.PROTOCOL
    assert list(vcu_dbc.PROTOCOL.nodes) == list(read.nodes)
    # Equal is not enough: 1 == 1.0 == True, and the decoders' source differs.
    assert repr(vcu_dbc.PROTOCOL) == repr(read)


def test_the_committed_module_is_what_the_dbc_says():
    module = REPOSITORY / "src/vcu_gateway/protocol/vcu_dbc.py"
    assert cantools_dbc.module_text(DBC_TEXT) == module.read_text(encoding="utf-8")


def test_the_module_of_any_dbc_says_the_same_as_that_dbc():
    text = DBC_TEXT.replace("Steering angle", "\\ ' {x}\\n \\\\ \u2028 Steering angle")
    assert text != DBC_TEXT
    made: dict[str, object] = {}
    exec(cantools_dbc.module_text(text), made)
    assert made["PROTOCOL"] == cantools_dbc.parse(text)
    assert made["SHA256"] == hashlib.sha256(text.encode()).hexdigest()


LOADED = """
import sys; from pathlib import Path; from vcu_gateway.protocol import dbc
protocol = dbc.load(Path(sys.argv[1]))
print("cantools" in sys.modules, protocol.message("IMU_Attitude").period_ms)
"""


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        pytest.param(b"", b"", "False 10\n", id="the packaged one"),
        pytest.param(b"this gateway", b"this Gateway", "True 10\n", id="a byte of a comment"),
        pytest.param(b"BO_ 2215432313 10;", b"BO_ 2215432313 20;", "True 20\n", id="a period"),
        pytest.param(b"\n", b"\r\n", "True 10\n", id="line ends"),
    ],
)
def test_cantools_reads_every_dbc_but_the_packaged_one(tmp_path, old, new, told):
    path = tmp_path / "own.dbc"
    path.write_bytes(DBC_TEXT.encode().replace(old, new, -1 if old else 0))
    done = subprocess.run([sys.executable, "-c", LOADED, path], capture_output=True, text=True)
    assert done.stdout == told, done.stderr


def test_generating_twice_gives_the_same_bytes():
    assert cantools_dbc.write(definition.load(packaged("vcu.yaml"))) == cantools_dbc.write(
        DEFINITION
    )


# What docs/protocol.md says, typed by hand: a slip of the definition's author is found here.
# message -> (identifier, sender, receiver, period ms)
MESSAGES = {
    "ARD2_SteeringWheel": (0x040AD092, "ARD2", "VCU", 100),
    "BMS_Status": (0x1808D0F4, "BMS", "VCU", 500),
    "BMS_Temperatures": (0x1809D0F4, "BMS", "VCU", 500),
    "IMU_Acceleration": (0x040AD079, "IMU", "VCU", 10),
    "IMU_AngularRate": (0x040BD079, "IMU", "VCU", 10),
    "IMU_Attitude": (0x040CD079, "IMU", "VCU", 10),
    "PCU1_Status1": (0x0808D0A7, "PCU1", "VCU", 500),
    "PCU1_Status2": (0x0809D0A7, "PCU1", "VCU", 50),
    "PCU2_Status1": (0x0808D0A8, "PCU2", "VCU", 500),
    "PCU2_Status2": (0x0809D0A8, "PCU2", "VCU", 50),
    "VCU_PCU1_Command": (0x0008A7D0, "VCU", "PCU1", 50),
    "VCU_PCU2_Command": (0x0008A8D0, "VCU", "PCU2", 50),
}

ADDRESSES = {"ARD2": 146, "BMS": 244, "IMU": 121, "PCU1": 167, "PCU2": 168, "VCU": 208}

# (signal, first byte from 1, first bit, length in bits, signed, factor, offset, unit, range)
CONTROL = [
    ("PowerMode", 1, 2, 2, False, 1, 0, "", (0, 3)),
    ("MotorReverse", 1, 4, 1, False, 1, 0, "", (0, 1)),
    ("RegenBrake", 1, 5, 1, False, 1, 0, "", (0, 1)),
    ("PowerCut", 1, 7, 1, False, 1, 0, "", (0, 1)),
    ("Throttle", 2, 0, 8, False, 0.39, 0, "%", (0, 99.45)),
    ("Brake", 3, 0, 8, False, 0.39, 0, "%", (0, 99.45)),
]
STATUS_1 = [
    *CONTROL,
    ("VoltageLevel", 4, 0, 3, False, 1, 0, "", (1, 5)),
    ("CurrentLevel", 4, 3, 2, False, 1, 0, "", (0, 2)),
    ("TemperatureProtectLevel", 4, 5, 2, False, 1, 0, "", (0, 2)),
    ("FocMode", 4, 7, 1, False, 1, 0, "", (0, 1)),
    ("StatusCode", 5, 0, 16, False, 1, 0, "", (0, 65535)),
    ("ControllerTemperature", 7, 0, 8, False, 1, 0, "degC", (0, 150)),
    ("MotorTemperature", 8, 0, 8, False, 1, 0, "degC", (0, 255)),
]
STATUS_2 = [
    ("BatteryVoltage", 1, 0, 16, False, 1 / 128, 0, "V", (0, 511.99)),
    ("BatteryCurrent", 3, 0, 16, True, 1 / 16, 0, "A", (-2048, 2047.9375)),
    ("PhaseCurrent", 5, 0, 16, True, 1 / 16, 0, "A", (-2048, 2047.9375)),
    ("MotorSpeed", 7, 0, 16, False, 1, 0, "rpm", (0, 6000)),
]
COMMAND = [
    *CONTROL,
    ("SpeedLimit", 5, 0, 16, False, 1, 0, "rpm", (0, 12000)),
    ("PowerLimit", 7, 0, 16, False, 1, 0, "W", (0, 60000)),
]


def three_words(names, factor, offset, unit, limit):
    return [
        (name, byte, 0, 16, False, factor, offset, unit, (-limit, limit))
        for name, byte in zip(names, (1, 3, 5), strict=True)
    ]


SIGNALS = {
    "ARD2_SteeringWheel": [
        ("SteeringAngle", 1, 0, 16, False, 0.003, -90, "deg", (-90, 90)),
        ("WheelSpeedFL", 3, 0, 16, False, 0.001, 0, "km/h", (0, 65.535)),
        ("WheelSpeedFR", 5, 0, 16, False, 0.001, 0, "km/h", (0, 65.535)),
    ],
    "BMS_Status": [
        ("PackVoltage", 1, 0, 16, False, 0.01, 0, "V", (0, 100)),
        ("SOC", 5, 0, 8, False, 1, 0, "%", (0, 100)),
        ("CellOvervoltage", 6, 0, 2, False, 1, 0, "", (0, 3)),
        ("CellUndervoltage", 6, 2, 2, False, 1, 0, "", (0, 3)),
        ("DischargeOvercurrent", 6, 6, 2, False, 1, 0, "", (0, 2)),
        ("TemperatureImbalance", 7, 0, 2, False, 1, 0, "", (0, 2)),
        ("Overtemperature", 7, 2, 2, False, 1, 0, "", (0, 2)),
        ("Undertemperature", 7, 4, 2, False, 1, 0, "", (0, 2)),
        ("VoltageImbalance", 7, 6, 1, False, 1, 0, "", (0, 1)),
        ("InternalFault", 7, 7, 1, False, 1, 0, "", (0, 1)),
        ("BatteryState", 8, 0, 2, False, 1, 0, "", (0, 2)),
        ("ErrorCode", 8, 2, 5, False, 1, 0, "", (0, 31)),
        ("LifeSignal", 8, 7, 1, False, 1, 0, "", (0, 1)),
    ],
    "BMS_Temperatures": [
        (f"PackTemperature{n}", n, 0, 8, False, 1, -50, "degC", (-50, 200)) for n in range(1, 6)
    ],
    "IMU_Acceleration": three_words(
        ("AccelerationX", "AccelerationY", "AccelerationZ"), 0.01, -78.48, "m/s2", 78.48
    ),
    "IMU_AngularRate": three_words(
        ("AngularRateX", "AngularRateY", "AngularRateZ"), 7.8125 / 1000, -245, "deg/s", 245
    ),
    "IMU_Attitude": three_words(("AttitudeX", "AttitudeY", "AttitudeZ"), 0.058, -85, "deg", 85),
    "PCU1_Status1": STATUS_1,
    "PCU2_Status1": STATUS_1,
    "PCU1_Status2": STATUS_2,
    "PCU2_Status2": STATUS_2,
    "VCU_PCU1_Command": COMMAND,
    "VCU_PCU2_Command": COMMAND,
}

LEVELS_TO_3 = {0: "normal", 1: "level1", 2: "level2", 3: "level3"}
LEVELS_TO_2 = {0: "normal", 1: "level1", 2: "level2", 3: "reserved"}
NAMES = {
    "PowerMode": {0: "eco", 1: "normal", 2: "turbo", 3: "safety"},
    "MotorReverse": {0: "forward", 1: "reverse"},
    "RegenBrake": {0: "off", 1: "on"},
    "PowerCut": {0: "normal", 1: "cut"},
    "VoltageLevel": {
        1: "under_minimum",
        2: "minimum_to_low",
        3: "low_to_high",
        4: "high_to_maximum",
        5: "over_maximum",
    },
    "CurrentLevel": {0: "eco", 1: "normal", 2: "turbo"},
    "TemperatureProtectLevel": {0: "good", 1: "turbo_disabled", 2: "motor_shutdown"},
    "FocMode": {0: "off", 1: "on"},
    "CellOvervoltage": LEVELS_TO_3,
    "CellUndervoltage": LEVELS_TO_3,
    "DischargeOvercurrent": LEVELS_TO_2,
    "TemperatureImbalance": LEVELS_TO_2,
    "Overtemperature": LEVELS_TO_2,
    "Undertemperature": LEVELS_TO_2,
    "VoltageImbalance": {0: "normal", 1: "level1"},
    "InternalFault": {0: "normal", 1: "level2"},
    "BatteryState": {0: "idle", 1: "charging", 2: "discharging", 3: "reserved"},
}


def test_the_nodes_are_those_of_the_source(protocol):
    assert dict(protocol.nodes) == ADDRESSES


def test_the_messages_are_those_of_the_source(protocol):
    assert {
        message.name: (message.can_id, message.sender, *message.receivers, message.period_ms)
        for message in protocol.messages
    } == MESSAGES


@pytest.mark.parametrize("name", MESSAGES)
def test_the_signals_are_those_of_the_source(protocol, name):
    message = protocol.message(name)
    assert [
        (
            signal.name,
            signal.start_bit // 8 + 1,
            signal.start_bit % 8,
            signal.length_bits,
            signal.signed,
            signal.factor,
            signal.offset,
            signal.unit,
            (signal.minimum, signal.maximum),
        )
        for signal in message.signals
    ] == SIGNALS[name]
    assert {signal.byte_order for signal in message.signals} == {"little"}


def test_the_codes_have_the_names_of_the_source(protocol):
    for message in protocol.messages:
        for signal in message.signals:
            assert signal.names == NAMES.get(signal.name, {}), f"{message.name}.{signal.name}"


def test_only_the_wheel_speeds_saturate(protocol):
    saturated = {
        signal.name: signal.saturated_raw
        for message in protocol.messages
        for signal in message.signals
        if signal.saturated_raw is not None
    }
    assert saturated == {"WheelSpeedFL": 0xFFFF, "WheelSpeedFR": 0xFFFF}


@pytest.fixture(scope="module", params=["utf-8", None], ids=["utf-8", "cantools' own encoding"])
def database(request):
    return cantools.database.load_file(DBC_PATH, encoding=request.param, strict=True)


def test_cantools_loads_the_dbc_strictly(database):
    assert {message.name for message in database.messages} == set(MESSAGES)


def test_each_message_has_what_other_tools_read(database):
    for message in database.messages:
        can_id, sender, receiver, period_ms = MESSAGES[message.name]
        assert (message.frame_id, message.is_extended_frame, message.length) == (can_id, True, 8)
        assert message.protocol == "j1939"
        assert message.dbc.attributes["VFrameFormat"].value == 3
        assert message.cycle_time == period_ms
        assert message.dbc.attributes["GenMsgCycleTime"].value == period_ms
        assert message.senders == [sender]
        assert message.receivers == {receiver}
        assert message.comment
    kinds = database.dbc.attribute_definitions["VFrameFormat"].choices
    assert kinds[3] == "J1939PG"
    assert database.dbc.attributes["ProtocolType"].value == "J1939"


def test_each_signal_has_what_other_tools_read(database):
    for message in database.messages:
        for expected, signal in zip(
            sorted(SIGNALS[message.name]),
            sorted(message.signals, key=lambda s: s.name),
            strict=True,
        ):
            name, byte, bit, length, signed, factor, offset, unit, (minimum, maximum) = expected
            assert (signal.name, signal.start, signal.length) == (
                name,
                (byte - 1) * 8 + bit,
                length,
            )
            assert (signal.is_signed, signal.scale, signal.offset) == (signed, factor, offset)
            assert (signal.unit or "", signal.minimum, signal.maximum) == (unit, minimum, maximum)
            choices = {code: str(choice) for code, choice in (signal.choices or {}).items()}
            assert choices == NAMES.get(name, {})


def test_each_node_has_its_address_and_a_comment(database):
    assert {
        node.name: node.dbc.attributes["NmStationAddress"].value for node in database.nodes
    } == ADDRESSES
    assert all(node.comment for node in database.nodes)


def test_the_source_terms_are_in_the_comments():
    read = cantools.database.load_file(DBC_PATH, encoding="utf-8")
    assert (
        read.get_message_by_name("ARD2_SteeringWheel").get_signal_by_name("SteeringAngle").comment
        == "方向盤轉角"
    )


def test_a_comment_with_quotes_survives():
    text = packaged("vcu.yaml").read_text(encoding="utf-8")
    plain, quoted = "comment: toggles on every frame", "comment: 'toggles \"always\", on | off'"
    text = text.replace(plain, quoted)
    defined = definition.parse(text)
    assert cantools_dbc.parse(cantools_dbc.write(defined)).messages == defined.spec.messages
    row = next(
        line
        for line in protocol_page.write(defined).splitlines()
        if line.startswith("| LifeSignal")
    )
    assert row.replace("\\|", "").count("|") == 9


def test_a_big_endian_signed_definition_survives():
    text = packaged("vcu.yaml").read_text(encoding="utf-8")
    received, command = text.split('  "VCU_{node}_Command":')
    received = received.replace("little\n", "big\n")
    received = received.replace("rpm, minimum: 0, maximum: 6000", "rpm, factor: -2")
    defined = definition.parse(f'{received}  "VCU_{{node}}_Command":{command}')
    read = cantools_dbc.parse(cantools_dbc.write(defined))
    assert read.messages == defined.spec.messages
    assert read.message("PCU1_Status2").signal("BatteryCurrent") == SignalSpec(
        "BatteryCurrent",
        23,
        16,
        -2048,
        2047.9375,
        "big",
        True,
        0.0625,
        unit="A",
        comment="電池電流; two's complement (E9)",
    )
    assert read.message("PCU1_Status2").signal("MotorSpeed").maximum == 0


def lines(*rows: str) -> str:
    return "\n".join(('VERSION ""', "BU_: A B", *rows, ""))


def test_a_foreign_dbc_without_our_attributes_is_read():
    text = lines("BO_ 2566844926 M: 8 A", ' SG_ S : 0|8@1+ (0.5,-1) [0|0] "x" B')
    assert cantools_dbc.parse(text) == ProtocolSpec(
        messages=(
            MessageSpec(
                "M",
                0x18FEF1FE,
                "A",
                ("B",),
                None,
                (SignalSpec("S", 0, 8, -1.0, 126.5, factor=0.5, offset=-1.0, unit="x"),),
            ),
        ),
        nodes={"A": 254, "B": 254},
    )


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            ["BO_ 291 M: 8 A", ' SG_ S : 0|8@1+ (1,0) [0|255] "" B'],
            "M (0x123): has an 11-bit identifier",
        ),
        (
            ["BO_ 2566844926 M: 4 A", ' SG_ S : 0|8@1+ (1,0) [0|255] "" B'],
            "M (0x18FEF1FE): has 4 bytes, not 8",
        ),
        (
            ["BO_ 2566844926 M: 8 Vector__XXX", ' SG_ S : 0|8@1+ (1,0) [0|255] "" B'],
            "M (0x18FEF1FE): has no sender",
        ),
        (
            [
                "BO_ 2566844926 M: 8 A",
                ' SG_ S : 0|32@1- (1,0) [0|0] "" B',
                "SIG_VALTYPE_ 2566844926 S : 1;",
            ],
            "M.S (0x18FEF1FE): is a float or multiplexed signal",
        ),
        (
            [
                "BO_ 2566844926 M: 8 A",
                ' SG_ X M : 0|8@1+ (1,0) [0|255] "" B',
                ' SG_ S m1 : 8|8@1+ (1,0) [0|255] "" B',
            ],
            "M.S (0x18FEF1FE): is a float or multiplexed signal",
        ),
        (["BO_ nonsense"], "is no DBC that cantools reads: "),
        (
            [
                "BO_ 2566844926 M: 8 A",
                ' SG_ S : 0|8@1+ (1,0) [0|255] "" B',
                ' SG_ T : 4|8@1+ (1,0) [0|255] "" B',
            ],
            'is no DBC that cantools reads: DBC: "The signals T and S are overlapping',
        ),
    ],
)
def test_a_dbc_that_this_gateway_cannot_decode_is_refused(rows, message):
    with pytest.raises(DataError) as caught:
        cantools_dbc.parse(lines(*rows), "other.dbc")
    assert f"other.dbc: {message}" in str(caught.value)


def test_a_dbc_that_cannot_be_read_is_missing_input(tmp_path):
    with pytest.raises(MissingInputError, match=r"none\.dbc: cannot be read: "):
        dbc.load(tmp_path / "none.dbc")
