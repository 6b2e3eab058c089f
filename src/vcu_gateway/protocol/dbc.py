"""DBC file -> protocol: the packaged one is known beforehand; what is required of any.

docs/protocol.md, What your own definition may change, says the same for people.
"""

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, TypeVar

from vcu_gateway.core import commands
from vcu_gateway.core.causes import BATTERY_EFFECTS, CONTROLLER_EFFECTS
from vcu_gateway.core.demand import CONTROLLERS, PowerMode
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, SPEED_LIMIT_HIGHEST_RPM
from vcu_gateway.errors import MissingInputError, Problem, nearest
from vcu_gateway.protocol import vcu_dbc

REMEDY = "see docs/protocol.md, What your own definition may change"
COMMAND_PERIOD_MS = 50

_FLAG = 2
_CONTROL_MODE = {
    "PowerMode": len(PowerMode),
    **dict.fromkeys(("MotorReverse", "RegenBrake", "PowerCut"), _FLAG),
}

PERIODS_MS: Mapping[str, int] = {
    "ARD2_SteeringWheel": 100,
    "BMS_Status": 500,
    "BMS_Temperatures": 500,
    "IMU_Acceleration": 10,
    "IMU_AngularRate": 10,
    "IMU_Attitude": 10,
    **dict.fromkeys((f"{controller}_Status1" for controller in CONTROLLERS), 500),
    **dict.fromkeys((f"{controller}_Status2" for controller in CONTROLLERS), 50),
}
"""Messages that the gateway needs, by name; the ages of docs/safety.md follow from the periods."""

_OF_BOTH: Mapping[str, Mapping[str, str | int]] = {
    "Status1": {
        **_CONTROL_MODE,
        **{name: len(effects) for name, effects in CONTROLLER_EFFECTS.items()},
        **dict.fromkeys(("Throttle", "Brake"), "%"),
        **dict.fromkeys(("CurrentLevel", "FocMode", "StatusCode"), ""),
        **dict.fromkeys(("ControllerTemperature", "MotorTemperature"), "degC"),
    },
    "Status2": {
        "BatteryVoltage": "V",
        **dict.fromkeys(("BatteryCurrent", "PhaseCurrent"), "A"),
        "MotorSpeed": "rpm",
    },
}

SIGNALS: Mapping[str, Mapping[str, str | int]] = {
    "ARD2_SteeringWheel": {
        "SteeringAngle": "deg",
        **dict.fromkeys(("WheelSpeedFL", "WheelSpeedFR"), "km/h"),
    },
    "BMS_Status": {
        "PackVoltage": "V",
        "SOC": "%",
        **{name: len(effects) for name, effects in BATTERY_EFFECTS.items()},
        **dict.fromkeys(("BatteryState", "ErrorCode"), ""),
        "LifeSignal": _FLAG,
    },
    "BMS_Temperatures": {f"PackTemperature{number}": "degC" for number in range(1, 6)},
    "IMU_Acceleration": {f"Acceleration{axis}": "m/s2" for axis in "XYZ"},
    "IMU_AngularRate": {f"AngularRate{axis}": "deg/s" for axis in "XYZ"},
    "IMU_Attitude": {f"Attitude{axis}": "deg" for axis in "XYZ"},
    **{f"{name}_{kind}": _OF_BOTH[kind] for name in CONTROLLERS for kind in _OF_BOTH},
}
"""Their signals: the unit of a quantity, or how many codes its bits hold."""


_COMMAND_NAMES = tuple(map(commands.message_name, CONTROLLERS))


class _Place(NamedTuple):
    """Bits of a signal of the command, from its lowest one, and its scale."""

    first_bit: int
    length_bits: int
    maximum: float
    factor: float = 1.0


_COMMAND: Mapping[str, _Place] = {
    "PowerMode": _Place(2, 2, 3),
    "MotorReverse": _Place(4, 1, 1),
    "RegenBrake": _Place(5, 1, 1),
    "PowerCut": _Place(7, 1, 1),
    "Throttle": _Place(8, 8, 99.45, 0.39),
    "Brake": _Place(16, 8, 99.45, 0.39),
    "SpeedLimit": _Place(32, 16, SPEED_LIMIT_HIGHEST_RPM),
    "PowerLimit": _Place(48, 16, POWER_LIMIT_HIGHEST_W),
}
"""Layout of a command: the gate checks its bytes without the protocol."""


_Wanted = TypeVar("_Wanted", str | int, _Place)


class Breach(NamedTuple):
    """What a protocol may not have: of a message, or of one of its signals; both may be missing."""

    message: str
    signal: str
    what: str


def unmet(protocol: ProtocolSpec, where: Callable[[str, str], str]) -> list[Problem]:
    """Everything that keeps the gateway from running with this protocol.

    `where` is file and line of a message and its signal, which is empty where it is the message.
    """
    by_name = {message.name: message for message in protocol.messages}
    found = [*_missing(by_name), *_received(by_name), *_commands(by_name), *_others(protocol)]
    return [
        Problem(_text(breach, by_name), where(breach.message, breach.signal), REMEDY)
        for breach in found
    ]


def with_aliases(protocol: ProtocolSpec, aliases: Mapping[int, str]) -> ProtocolSpec:
    """The protocol with these further identifiers, as far as it has their messages."""
    names = {message.name for message in protocol.messages}
    kept = {can_id: name for can_id, name in aliases.items() if name in names}
    return dataclasses.replace(protocol, aliases=kept)


def _text(breach: Breach, by_name: Mapping[str, MessageSpec]) -> str:
    name = breach.message + (f".{breach.signal}" if breach.signal else "")
    message = by_name.get(breach.message)
    return f"{name}{hexadecimal(message) if message else ''}: {breach.what}"


def hexadecimal(message: MessageSpec) -> str:
    """The identifier, for behind the message's name."""
    return f" (0x{message.can_id:08X})"


def _missing(by_name: Mapping[str, MessageSpec]) -> Iterator[Breach]:
    needed = (*PERIODS_MS, *_COMMAND_NAMES)
    own = [name for name in by_name if name not in needed]
    for name in needed:
        if name not in by_name:
            alike = nearest(name, own)
            yield Breach(alike or name, "", _is_missing(name, alike))


def _is_missing(name: str, alike: str | None) -> str:
    if alike is None:
        return "is missing, and the gateway reads it"
    return f"is this {name}? The gateway reads it by that name, and it is missing"


def _received(by_name: Mapping[str, MessageSpec]) -> Iterator[Breach]:
    for name, period_ms in PERIODS_MS.items():
        if message := by_name.get(name):
            if OWN_NODE not in message.receivers or message.sender == OWN_NODE:
                yield Breach(name, "", f"must come from another node to {OWN_NODE}")
            yield from _period(message, period_ms)
            yield from _signals(message, SIGNALS[name], _quantity)


def _period(message: MessageSpec, period_ms: int) -> Iterator[Breach]:
    if message.period_ms != period_ms:
        said = "there is none" if message.period_ms is None else f"not {message.period_ms} ms"
        yield Breach(message.name, "", f"the period must be {period_ms} ms, {said}")


def _signals(
    message: MessageSpec,
    wanted: Mapping[str, _Wanted],
    faults: Callable[[SignalSpec, _Wanted], Iterator[str]],
) -> Iterator[Breach]:
    by_name = {signal.name: signal for signal in message.signals}
    own = [name for name in by_name if name not in wanted]
    for name, one in wanted.items():
        if signal := by_name.get(name):
            for what in faults(signal, one):
                yield Breach(message.name, name, what)
        else:
            alike = nearest(name, own)
            yield Breach(message.name, alike or name, _is_missing(name, alike))


def _quantity(signal: SignalSpec, wanted: str | int) -> Iterator[str]:
    if isinstance(wanted, str):
        if signal.unit != wanted:
            yield f"the unit must be {wanted or 'none'}, not {signal.unit or 'none'}"
    elif (signal.raw_lowest, signal.raw_highest) != (0, wanted - 1):
        held = f"{signal.raw_lowest}..{signal.raw_highest}"
        yield f"the bits must hold the codes 0..{wanted - 1}, not {held}"
    elif (signal.factor, signal.offset) != (1, 0):
        yield "a code has factor 1 and offset 0"


def _commands(by_name: Mapping[str, MessageSpec]) -> Iterator[Breach]:
    for controller in CONTROLLERS:
        message = by_name.get(commands.message_name(controller))
        if message is None:
            continue
        if message.sender != OWN_NODE or controller not in message.receivers:
            yield Breach(message.name, "", f"must go from {OWN_NODE} to {controller}")
        yield from _period(message, COMMAND_PERIOD_MS)
        yield from _signals(message, _COMMAND, _laid_out)
        for name in message.signal_names:
            if name not in _COMMAND:
                what = "a command has no further signal: its other bits are sent as 0"
                yield Breach(message.name, name, what)


def _laid_out(signal: SignalSpec, place: _Place) -> Iterator[str]:
    first, length = place.first_bit, place.length_bits
    if signal.bit_positions() != tuple(range(first, first + length)) or signal.signed:
        yield f"must be the {length} bits from B{first // 8 + 1}[{first % 8}] on, unsigned"
    for name, value, wanted in (
        ("factor", signal.factor, place.factor),
        ("offset", signal.offset, 0),
        ("minimum", signal.minimum, 0),
        ("maximum", signal.maximum, place.maximum),
    ):
        if value != wanted:
            yield f"the {name} must be {wanted:g}, not {value:g}"


def _others(protocol: ProtocolSpec) -> Iterator[Breach]:
    """Further messages: each comes to the gateway, with something in it."""
    for message in protocol.messages:
        if message.name in PERIODS_MS or message.name in _COMMAND_NAMES:
            continue
        if message.sender == OWN_NODE:
            what = f"{OWN_NODE} commands {' and '.join(CONTROLLERS)} and sends nothing else"
            yield Breach(message.name, "", what)
        elif not message.signals:
            yield Breach(message.name, "", "has no signal")
        elif OWN_NODE not in message.receivers:
            what = f"must go to {OWN_NODE}, which reads nothing else: take it out"
            yield Breach(message.name, "", what)


_OF_MESSAGE = {"can_id": "identifier", "sender": "sender", "period_ms": "period_ms"}
_OF_SIGNAL = (
    *("start_bit", "length_bits", "byte_order", "signed", "factor", "offset"),
    *("minimum", "maximum", "saturated_raw"),
)


def differences(found: ProtocolSpec, reference: ProtocolSpec) -> Iterator[str]:
    """Differences of `found` from the messages and signals of `reference`, a sentence each.

    What it has besides does not count.
    """
    by_name = {message.name: message for message in found.messages}
    if not any(message.name in by_name for message in reference.messages):
        yield "has none of this vehicle's messages: it is the DBC of something else"
        return
    for expected in reference.messages:
        message = by_name.get(expected.name)
        if message is None:
            yield f"there is no message {expected.name}{hexadecimal(expected)}"
        else:
            yield from _of_message(message, expected)


def _of_message(message: MessageSpec, expected: MessageSpec) -> Iterator[str]:
    where = f"{message.name}{hexadecimal(expected)}"
    for name, label in _OF_MESSAGE.items():
        values = getattr(message, name), getattr(expected, name)
        if name == "can_id":
            values = f"0x{values[0]:08X}", f"0x{values[1]:08X}"
        yield from _of_value(where, label, *values)
    by_name = {signal.name: signal for signal in message.signals}
    for signal in expected.signals:
        if signal.name not in by_name:
            yield f"{where}: there is no signal {signal.name}"
        else:
            where_signal = f"{message.name}.{signal.name}{hexadecimal(expected)}"
            for name in _OF_SIGNAL:
                values = getattr(by_name[signal.name], name), getattr(signal, name)
                yield from _of_value(where_signal, name, *values)


def _of_value(where: str, name: str, value: object, expected: object) -> Iterator[str]:
    if value != expected:
        yield f"{where}: {name} is {value}, not {expected}"


def load(path: Path) -> ProtocolSpec:
    """Read a DBC for the decoders and encoders.

    Raises MissingInputError where it cannot be read, DataError where it is no DBC or holds
    what this gateway cannot decode.
    """
    if path.exists() and not path.is_file():
        raise MissingInputError(Problem("is no regular file", str(path)))
    try:
        contents = path.read_bytes()
        text = contents.decode().replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise MissingInputError(Problem(f"cannot be read: {error}", str(path))) from error
    if hashlib.sha256(contents).hexdigest() == vcu_dbc.SHA256:
        return vcu_dbc.PROTOCOL
    # Imported where it is needed: no start with the packaged DBC waits for cantools.
    from vcu_gateway.protocol import cantools_dbc

    return cantools_dbc.parse(text, str(path))
