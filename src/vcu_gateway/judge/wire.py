"""Frames of the bus in the judge's own arithmetic, from docs/protocol.md by hand."""

from collections.abc import Mapping
from typing import NamedTuple

MS = 1_000_000
CONTROLLERS = ("PCU1", "PCU2")
PERCENT_PER_BIT = 0.39
HIGHEST_RAW = 255
POWER_MODES = ("eco", "normal", "turbo", "safety")
"""PowerMode's names by their codes."""
SAFETY_MODE = 3
LENGTH = 8
_RELEASED_RAW = 12

COMMAND_IDS: Mapping[str, int] = {"PCU1": 0x0008A7D0, "PCU2": 0x0008A8D0}
RECEIVED_IDS: Mapping[int, str] = {
    0x040AD092: "ARD2_SteeringWheel",
    0x1808D0F4: "BMS_Status",
    0x1809D0F4: "BMS_Temperatures",
    0x040AD079: "IMU_Acceleration",
    0x040BD079: "IMU_AngularRate",
    0x040CD079: "IMU_Attitude",
    0x0808D0A7: "PCU1_Status1",
    0x0809D0A7: "PCU1_Status2",
    0x0808D0A8: "PCU2_Status1",
    0x0809D0A8: "PCU2_Status2",
}
MATCH = 0x03FF_FFFF
"""What tells a frame: PF, PS and SA, whatever its priority (E1)."""

_PRIORITY = 0x1C00_0000
_MESSAGE_BY_KEY = {can_id & MATCH: name for can_id, name in RECEIVED_IDS.items()}
_COMMAND_BY_KEY = {can_id & MATCH: name for name, can_id in COMMAND_IDS.items()}
# PF 8 on page 0 and the receiver; the last byte is the sender.
_COMMANDED = {0x0008A7, 0x0008A8, 0x0008FF}
REVERSE, _REGEN, _CUT, _UNUSED = 0x10, 0x20, 0x80, 0x43


class ReceivedSignals(NamedTuple):
    """Signals that are received: where they stand, and what their codes mean.

    Attributes:
        places: first byte of each signal in each message; of `width` bytes, little-endian.
        highest_raw: what is above it is out of range.
    """

    messages: tuple[str, ...]
    places: tuple[int, ...]
    width: int
    highest_raw: int
    per_bit: float = 1.0
    offset: float = 0.0

    def raws(self, data: bytes) -> list[int]:
        """Codes of its signals in one frame."""
        return [int.from_bytes(data[at : at + self.width], "little") for at in self.places]


_STATUS1 = tuple(f"{name}_Status1" for name in CONTROLLERS)
_STATUS2 = tuple(f"{name}_Status2" for name in CONTROLLERS)
_PACKS = ReceivedSignals(("BMS_Temperatures",), (0, 1, 2, 3, 4), 1, 250, offset=-50.0)
MOTOR_HIGHEST_RPM = 6_000
MOTOR_SPEED = ReceivedSignals(_STATUS2, (6,), 2, MOTOR_HIGHEST_RPM)
WHEEL_SPEEDS = ReceivedSignals(("ARD2_SteeringWheel",), (2, 4), 2, 65_535)
INPUTS: Mapping[str, ReceivedSignals] = {
    "motor_temperature_c": ReceivedSignals(_STATUS1, (7,), 1, 255),
    "controller_temperature_c": ReceivedSignals(_STATUS1, (6,), 1, 150),
    "pack_temperature_max_c": _PACKS,
    "pack_temperature_min_c": _PACKS,
    "soc_pct": ReceivedSignals(("BMS_Status",), (4,), 1, 100),
    "battery_voltage_v": ReceivedSignals(_STATUS2, (0,), 2, 65_534, per_bit=1 / 128),
    "motor_speed_rpm": MOTOR_SPEED,
}
"""Inputs of curves, as keys name them (docs/safety.md, Tuning)."""


class CommandBytes(NamedTuple):
    """Command frame taken apart; throttle and brake are codes of 0.39 %."""

    power_mode: int
    reverse: bool
    regenerates: bool
    cut: bool
    throttle_raw: int
    brake_raw: int
    speed_limit_rpm: int
    power_limit_w: int
    unused: int

    @property
    def safe(self) -> bool:
        """ZERO_TORQUE or POWER_CUT, in either direction."""
        torque = self.throttle_raw or self.brake_raw or self.power_limit_w or self.regenerates
        return not torque and self.power_mode == SAFETY_MODE

    @property
    def released(self) -> bool:
        """The throttle is below 5 %."""
        return self.throttle_raw <= _RELEASED_RAW


def command_bytes(data: bytes) -> CommandBytes:
    first = data[0]
    return CommandBytes(
        first >> 2 & 3,
        bool(first & REVERSE),
        bool(first & _REGEN),
        bool(first & _CUT),
        data[1],
        data[2],
        data[4] | data[5] << 8,
        data[6] | data[7] << 8,
        first & _UNUSED | data[3] << 8,
    )


def command_id(controller: str, priority: int) -> int:
    return COMMAND_IDS[controller] & ~_PRIORITY | priority << 26


def messages(aliases: Mapping[int, str]) -> dict[int, str]:
    """Names of the vehicle's messages by what tells a frame, with the configured aliases."""
    return {can_id & MATCH: name for can_id, name in aliases.items()} | _MESSAGE_BY_KEY


def controller_commanded(can_id: int) -> str | None:
    """The controller that our own command with this identifier is for."""
    return _COMMAND_BY_KEY.get(can_id & MATCH)


def commands_somebody(can_id: int) -> bool:
    """True for a command to a controller or to all, whoever sends it."""
    return (can_id & MATCH) >> 8 in _COMMANDED


def speed_rpm(status2: bytes) -> int:
    return status2[6] | status2[7] << 8
