"""The codec against cantools, and against the protocol's edges."""

import math
import random
from pathlib import Path

import cantools
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from vcu_gateway.core.codec import Codec, Decoded, MessageCodec, Reason, compile_message
from vcu_gateway.core.j1939 import Frame, with_priority
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.core.state import Quality, mark
from vcu_gateway.protocol import dbc, packaged

PROTOCOL = dbc.load(packaged("vcu.dbc"))
CODEC = Codec(PROTOCOL)
ORACLE = cantools.database.load_file(Path(packaged("vcu.dbc")), encoding="utf-8", sort_signals=None)

PATIENT = settings(deadline=None)
MESSAGES = pytest.mark.parametrize("name", CODEC.by_name)
ANY_MESSAGE = st.sampled_from(PROTOCOL.messages)
PAYLOADS = st.binary(min_size=8, max_size=8)
SIGNALS = [
    pytest.param(message.name, signal, id=f"{message.name}.{signal.name}")
    for message in PROTOCOL.messages
    for signal in message.signals
]
EVERY_SIGNAL = pytest.mark.parametrize(("name", "signal"), SIGNALS)


def decode(name: str, data: bytes) -> Decoded:
    return CODEC.by_name[name].decode(data)


def raws_of(codec: MessageCodec, values: dict[str, float]) -> dict[str, int]:
    decoded = codec.decode(codec.encode(values))
    return dict(zip(codec.spec.signal_names, decoded.raws, strict=True))


def assert_decodes_like(codec: MessageCodec, oracle, data: bytes) -> None:
    decoded = codec.decode(data)
    names = codec.spec.signal_names
    raws = oracle.decode(data, scaling=False, decode_choices=False)
    assert dict(zip(names, decoded.raws, strict=True)) == raws
    values = oracle.decode(data, decode_choices=False)
    for name, value in zip(names, decoded.values, strict=True):
        assert math.isclose(value, values[name], rel_tol=1e-9, abs_tol=1e-9), name


# Decoding


@PATIENT
@given(ANY_MESSAGE, PAYLOADS)
def test_decoding_agrees_with_cantools(message, data):
    assert_decodes_like(CODEC.by_name[message.name], ORACLE.get_message_by_name(message.name), data)


@MESSAGES
@pytest.mark.parametrize("byte", [0x00, 0xFF, 0x55, 0xAA, 0x80, 0x01])
def test_decoding_agrees_with_cantools_at_the_edges(name, byte):
    oracle = ORACLE.get_message_by_name(name)
    assert_decodes_like(CODEC.by_name[name], oracle, bytes([byte]) * 8)
    for position in range(8):
        data = bytearray(8)
        data[position] = byte
        assert_decodes_like(CODEC.by_name[name], oracle, bytes(data))


@MESSAGES
def test_a_bytearray_decodes_like_bytes(name):
    data = random.Random(name).randbytes(8)
    assert decode(name, data) == CODEC.by_name[name].decode(bytearray(data))


def test_values_with_a_whole_factor_and_offset_stay_whole():
    decoded = decode("BMS_Temperatures", bytes([0, 50, 250, 255, 1, 0, 0, 0]))
    assert decoded.values == (-50, 0, 200, 205, -49)
    assert all(type(value) is int for value in decoded.values)


# Marks, errata E4, E11, E12


def frame_with(name: str, signal: SignalSpec, raw: int) -> bytes:
    """A frame in which every other signal holds a code in the middle of its range."""
    raws = {s.name: (s.raw_minimum + s.raw_maximum) // 2 for s in PROTOCOL.message(name).signals}
    return ORACLE.encode_message(name, raws | {signal.name: raw}, scaling=False, strict=False)


@EVERY_SIGNAL
def test_codes_are_marked_one_bit_beyond_the_range(name, signal):
    index = PROTOCOL.message(name).signals.index(signal)
    low, high = signal.raw_minimum, signal.raw_maximum
    for raw in {low - 1, low, high, high + 1, signal.raw_lowest, signal.raw_highest}:
        if not signal.raw_lowest <= raw <= signal.raw_highest:
            continue
        decoded = decode(name, frame_with(name, signal, raw))
        inside = low <= raw <= high
        expected = Quality.GOOD if inside else Quality.OUT_OF_RANGE
        if raw == signal.saturated_raw:
            expected = Quality.SATURATED
        assert decoded.raws[index] == raw
        assert mark(decoded, index, signal) is expected
        assert decoded.marks == (0 if expected is Quality.GOOD else 1 << index)


@EVERY_SIGNAL
def test_the_range_in_codes_is_the_range_in_units(name, signal):
    def physical(raw):
        return raw * signal.factor + signal.offset

    noise = abs(signal.factor) * 1e-6
    for raw in (signal.raw_minimum, signal.raw_maximum):
        assert signal.minimum - noise <= physical(raw) <= signal.maximum + noise
    if signal.raw_minimum > signal.raw_lowest:
        assert physical(signal.raw_minimum - 1) < signal.minimum
    if signal.raw_maximum < signal.raw_highest:
        assert physical(signal.raw_maximum + 1) > signal.maximum


@pytest.mark.parametrize(
    ("name", "signal", "raw_minimum", "raw_maximum"),
    [
        ("ARD2_SteeringWheel", "SteeringAngle", 0, 60000),
        ("ARD2_SteeringWheel", "WheelSpeedFL", 0, 65535),
        ("BMS_Status", "PackVoltage", 0, 10000),
        ("BMS_Status", "SOC", 0, 100),
        ("BMS_Status", "DischargeOvercurrent", 0, 2),
        ("BMS_Temperatures", "PackTemperature1", 0, 250),
        ("IMU_Acceleration", "AccelerationX", 0, 15696),
        ("IMU_AngularRate", "AngularRateX", 0, 62720),
        ("IMU_Attitude", "AttitudeX", 0, 2931),
        ("PCU1_Status1", "VoltageLevel", 1, 5),
        ("PCU1_Status1", "ControllerTemperature", 0, 150),
        ("PCU1_Status2", "BatteryVoltage", 0, 65534),
        ("PCU1_Status2", "BatteryCurrent", -32768, 32767),
        ("PCU1_Status2", "MotorSpeed", 0, 6000),
        ("VCU_PCU1_Command", "Throttle", 0, 255),
        ("VCU_PCU1_Command", "SpeedLimit", 0, 12000),
        ("VCU_PCU1_Command", "PowerLimit", 0, 60000),
    ],
)
def test_the_limits_in_codes_are_those_worked_out_by_hand(name, signal, raw_minimum, raw_maximum):
    spec = PROTOCOL.message(name).signal(signal)
    assert (spec.raw_minimum, spec.raw_maximum) == (raw_minimum, raw_maximum)


def test_a_wheel_speed_of_all_ones_is_kept_and_marked_saturated():
    decoded = decode("ARD2_SteeringWheel", bytes.fromhex("0000FFFFFEFF0000"))
    left, right = PROTOCOL.message("ARD2_SteeringWheel").signals[1:]
    assert decoded.values[1:] == (65.535, 65.534)
    assert mark(decoded, 1, left) is Quality.SATURATED
    assert mark(decoded, 2, right) is Quality.GOOD


def test_a_motor_speed_beyond_its_range_is_kept():
    decoded = decode("PCU1_Status2", bytes(6) + (6001).to_bytes(2, "little"))
    assert decoded.values[3] == 6001
    assert decoded.marks == 1 << 3


# Encoding, erratum E10


@MESSAGES
@PATIENT
@given(st.data())
def test_encoding_and_decoding_is_the_identity_within_half_a_bit(name, data):
    codec = CODEC.by_name[name]
    values = {
        signal.name: data.draw(st.floats(signal.minimum, signal.maximum), label=signal.name)
        for signal in codec.spec.signals
    }
    decoded = codec.decode(codec.encode(values))
    for signal, value, raw in zip(codec.spec.signals, decoded.values, decoded.raws, strict=True):
        assert signal.raw_minimum <= raw <= signal.raw_maximum
        half_a_bit = abs(signal.factor) / 2
        # A range may end between two codes: the last one is as near as it gets.
        slack = (
            half_a_bit if raw not in (signal.raw_minimum, signal.raw_maximum) else 2 * half_a_bit
        )
        assert abs(value - values[signal.name]) <= slack * (1 + 1e-9)


@MESSAGES
@PATIENT
@given(st.data())
def test_encoding_agrees_with_cantools(name, data):
    spec = PROTOCOL.message(name)
    raws = {s.name: data.draw(st.integers(s.raw_minimum, s.raw_maximum)) for s in spec.signals}
    values = {s.name: raws[s.name] * s.factor + s.offset for s in spec.signals}
    expected = ORACLE.encode_message(name, raws, scaling=False)
    assert CODEC.by_name[name].encode(values) == expected


@EVERY_SIGNAL
def test_encoding_saturates_and_never_wraps(name, signal):
    codec = CODEC.by_name[name]
    lowest = [-math.inf, -1e308, -1e9, -(10**400), math.nan]
    highest = [math.inf, 1e308, 1e9, 10**400]
    for value in [*lowest, signal.minimum, signal.minimum - abs(signal.factor)]:
        assert raws_of(codec, {signal.name: value})[signal.name] == signal.raw_minimum, value
    for value in [*highest, signal.maximum, signal.maximum + abs(signal.factor)]:
        assert raws_of(codec, {signal.name: value})[signal.name] == signal.raw_maximum, value


@MESSAGES
@PATIENT
@given(st.data())
@example(None)
def test_encoding_never_raises(name, data):
    codec = CODEC.by_name[name]
    number = st.floats() | st.integers() | st.booleans() | st.none()
    drawn = {} if data is None else {s: data.draw(number) for s in codec.spec.signal_names}
    values = {name: value for name, value in drawn.items() if value is not None}
    decoded = codec.decode(codec.encode(values))
    for signal, raw in zip(codec.spec.signals, decoded.raws, strict=True):
        assert signal.raw_minimum <= raw <= signal.raw_maximum


@pytest.mark.parametrize(
    ("throttle_pct", "raw"),
    [(0, 0), (0.19, 0), (0.2, 1), (50, 128), (99.2, 254), (99.26, 255), (99.45, 255), (100, 255)],
)
def test_full_throttle_is_255_and_not_0(throttle_pct, raw):
    codec = CODEC.by_name["VCU_PCU1_Command"]
    assert raws_of(codec, {"Throttle": throttle_pct})["Throttle"] == raw


def test_a_signal_left_out_is_sent_as_the_code_nearest_to_0():
    assert CODEC.by_name["VCU_PCU1_Command"].encode({}) == bytes(8)
    assert raws_of(CODEC.by_name["BMS_Temperatures"], {})["PackTemperature1"] == 50
    assert raws_of(CODEC.by_name["PCU1_Status1"], {})["VoltageLevel"] == 1


def test_reserved_bits_are_sent_as_0():
    most = {signal.name: math.inf for signal in PROTOCOL.message("VCU_PCU1_Command").signals}
    assert CODEC.by_name["VCU_PCU1_Command"].encode(most).hex() == "bcffff00e02e60ea"


# Synthetic protocols: both byte orders, signed, odd places


@st.composite
def layouts(draw):
    """A message whose signals share 64 bits without overlapping."""
    signals: list[SignalSpec] = []
    taken: set[int] = set()
    for index in range(draw(st.integers(0, 8))):
        length_bits = draw(
            st.sampled_from([1, 2, 3, 5, 7, 8, 9, 12, 13, 16, 17, 24, 31, 32, 48, 64])
        )
        signed = draw(st.booleans())
        spec = SignalSpec(
            f"S{index}",
            draw(st.integers(0, 63)),
            length_bits,
            minimum=-math.inf,
            maximum=math.inf,
            byte_order=draw(st.sampled_from(["little", "big"])),
            signed=signed,
            factor=draw(st.sampled_from([1.0, 2.0, 0.5, 0.01, -0.25, 0.0078125])),
            offset=draw(st.sampled_from([0.0, -40.0, 12.5])),
        )
        bits = spec.bit_positions()
        if max(bits) > 63 or min(bits) < 0 or taken & set(bits):
            continue
        taken |= set(bits)
        ends = [raw * spec.factor + spec.offset for raw in (spec.raw_lowest, spec.raw_highest)]
        signals.append(_with_range(spec, min(ends), max(ends)))
    return MessageSpec("M", 0x18FEF1FE, "A", ("B",), 100, tuple(signals))


def _with_range(spec: SignalSpec, minimum: float, maximum: float) -> SignalSpec:
    return SignalSpec(
        spec.name,
        spec.start_bit,
        spec.length_bits,
        minimum,
        maximum,
        spec.byte_order,
        spec.signed,
        spec.factor,
        spec.offset,
    )


def oracle_of(message: MessageSpec):
    def signal(spec: SignalSpec):
        return cantools.database.Signal(
            spec.name,
            spec.start_bit,
            spec.length_bits,
            byte_order="little_endian" if spec.byte_order == "little" else "big_endian",
            is_signed=spec.signed,
            conversion=cantools.database.conversion.BaseConversion.factory(
                spec.factor, spec.offset
            ),
        )

    return cantools.database.Message(
        message.can_id,
        message.name,
        8,
        [signal(s) for s in message.signals],
        is_extended_frame=True,
    )


@PATIENT
@given(layouts(), PAYLOADS)
def test_any_layout_decodes_like_cantools(message, data):
    assert_decodes_like(compile_message(message), oracle_of(message), data)


@PATIENT
@given(layouts(), st.data())
def test_any_layout_encodes_like_cantools(message, data):
    assume(message.signals)
    raws = {
        s.name: data.draw(st.integers(s.raw_lowest, s.raw_highest), label=s.name)
        for s in message.signals
        if s.length_bits <= 48
    }
    rest = {s.name: 0 for s in message.signals if s.length_bits > 48}
    values = {s.name: (raws | rest)[s.name] * s.factor + s.offset for s in message.signals}
    expected = oracle_of(message).encode(raws | rest, scaling=False)
    assert compile_message(message).encode(values) == expected


@PATIENT
@given(layouts(), st.data())
def test_any_layout_saturates(message, data):
    codec = compile_message(message)
    values = {s.name: data.draw(st.floats(), label=s.name) for s in message.signals}
    decoded = codec.decode(codec.encode(values))
    for signal, raw in zip(message.signals, decoded.raws, strict=True):
        value = values[signal.name]
        scaled = (value - signal.offset) / signal.factor
        if math.isnan(value) or scaled <= signal.raw_minimum:
            assert raw == signal.raw_minimum
        elif scaled >= signal.raw_maximum:
            assert raw == signal.raw_maximum
        else:
            assert abs(raw - scaled) <= 0.5


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("orders", [("big", "little"), ("little", "big"), ("big", "big")])
def test_whole_words_decode_like_cantools_in_either_and_in_both_byte_orders(orders, signed):
    starts = {"little": (0, 16), "big": (7, 23)}
    signals = tuple(
        SignalSpec(f"S{n}", starts[order][n], 16, -32768, 65535, order, signed)
        for n, order in enumerate(orders)
    )
    message = MessageSpec("M", 0x18FEF1FE, "A", ("B",), 100, signals)
    codec = compile_message(message)
    rng = random.Random(str(orders))
    for data in (bytes(range(1, 9)), *(rng.randbytes(8) for _ in range(20))):
        assert_decodes_like(codec, oracle_of(message), data)


ODD_PLACES = MessageSpec(
    "M",
    0x18FEF1FE,
    "A",
    ("B",),
    100,
    (
        SignalSpec("LittleAcrossBytes", 3, 7, 0, 127),
        SignalSpec("SignedInAByte", 10, 3, -4, 3, signed=True),
        SignalSpec("BigAcrossBytes", 18, 12, -2048, 2047, "big", signed=True),
        SignalSpec("BigInAByte", 38, 4, 0, 15, "big"),
        SignalSpec("Byte", 40, 8, -128, 127, signed=True),
        SignalSpec("BigBits", 50, 5, 0, 31, "big"),
    ),
)


def test_odd_places_decode_and_encode_like_cantools():
    codec, oracle = compile_message(ODD_PLACES), oracle_of(ODD_PLACES)
    rng = random.Random(1)
    for _ in range(200):
        assert_decodes_like(codec, oracle, rng.randbytes(8))
        values = {s.name: rng.randint(s.raw_minimum, s.raw_maximum) for s in ODD_PLACES.signals}
        assert codec.encode(values) == oracle.encode(values)


def test_a_message_without_signals_is_eight_bytes_of_nothing():
    codec = compile_message(MessageSpec("M", 0, "A", ("B",), None, ()))
    assert codec.encode({}) == bytes(8)
    assert codec.decode(b"\xff" * 8) == ((), (), 0)


def test_a_saturated_code_inside_the_range_is_marked_alone():
    signal = SignalSpec("S", 0, 8, 0, 200, saturated_raw=150)
    codec = compile_message(MessageSpec("M", 0, "A", ("B",), None, (signal,)))
    marked = [raw for raw in range(256) if codec.decode(bytes([raw, *bytes(7)])).marks]
    assert marked == [150, *range(201, 256)]


def test_a_saturated_code_beyond_the_range_is_saturated_too():
    signal = SignalSpec("S", 0, 8, 0, 200, saturated_raw=255)
    codec = compile_message(MessageSpec("M", 0, "A", ("B",), None, (signal,)))
    decoded = codec.decode(b"\xff" * 8)
    assert mark(decoded, 0, signal) is Quality.SATURATED


# Which frames are decoded, errata E1, E3


def frame(can_id: int, data: bytes = bytes(8), **kind: bool) -> Frame:
    return Frame(can_id, data, 0, **kind)


@MESSAGES
@pytest.mark.parametrize("priority", range(8))
def test_a_message_is_known_at_every_priority(codec, name, priority):
    can_id = with_priority(PROTOCOL.message(name).can_id, priority)
    found = codec.find(frame(can_id))
    assert found is codec.by_name[name]


@pytest.mark.parametrize("priority", range(8))
def test_the_second_attitude_identifier_is_the_attitude(codec, priority):
    found = codec.find(frame(with_priority(0x08F02DE2, priority)))
    assert found is codec.by_name["IMU_Attitude"]
    assert CODEC.find(frame(0x08F02DE2)) is Reason.UNKNOWN


@pytest.mark.parametrize(
    ("rejected", "reason"),
    [
        (frame(0x040AD079, error=True), Reason.ERROR),
        (frame(0x040AD079, bytes(8), error=True, remote=True), Reason.ERROR),
        (frame(0x004, error=True, extended=False), Reason.ERROR),
        (frame(0x040AD079, b"", remote=True), Reason.REMOTE),
        (frame(0x079, extended=False), Reason.STANDARD),
        (frame(0x040AD079, extended=False), Reason.STANDARD),
        (frame(0x18FF0012), Reason.UNKNOWN),
        (frame(0x040AD17A), Reason.UNKNOWN),
        (frame(0x060AD079), Reason.UNKNOWN),
        (frame(0x050AD079), Reason.UNKNOWN),
        (frame(0x040AD07A), Reason.FOREIGN_SOURCE),
        (frame(0x1C08D0F5), Reason.FOREIGN_SOURCE),
        (frame(0x08F02D00), Reason.FOREIGN_SOURCE),
        *[(frame(0x040AD079, bytes(n)), Reason.SHORT) for n in range(8)],
        (frame(0x040AD079, bytes(9)), Reason.LONG),
        (frame(0x040AD079, bytes(12)), Reason.LONG),
        (frame(0x040AD079, bytes(64)), Reason.LONG),
        (frame(0x18FF0012, bytes(3)), Reason.UNKNOWN),
    ],
)
def test_a_frame_that_is_not_decoded_has_one_reason(codec, rejected, reason):
    assert codec.find(rejected) is reason


def test_the_identifiers_are_all_messages_and_aliases(codec):
    known = {with_priority(message.can_id, 0) for message in PROTOCOL.messages}
    assert CODEC.identifiers() == tuple(sorted(known))
    assert set(codec.identifiers()) == known | {0x00F02DE2}


@PATIENT
@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=64), st.booleans(), st.booleans())
def test_no_frame_is_decoded_but_those_of_the_protocol(can_id, data, remote, extended):
    found = CODEC.find(frame(can_id, data, remote=remote, extended=extended))
    if isinstance(found, MessageCodec):
        assert extended
        assert not remote
        assert len(data) == 8
        assert with_priority(can_id, 0) == with_priority(found.spec.can_id, 0)
