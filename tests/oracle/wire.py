"""Frames of the bus in this oracle's own arithmetic, written from docs/protocol.md by hand."""

import socket
import struct
from dataclasses import dataclass

CHANNEL = "vcan0"
PCU1_COMMAND = 0x0008A7D0
PCU2_COMMAND = 0x0008A8D0
COMMANDS = (PCU1_COMMAND, PCU2_COMMAND)
IDENTIFIERS = {
    "ARD2_SteeringWheel": 0x040AD092,
    "BMS_Status": 0x1808D0F4,
    "BMS_Temperatures": 0x1809D0F4,
    "IMU_Acceleration": 0x040AD079,
    "IMU_AngularRate": 0x040BD079,
    "IMU_Attitude": 0x040CD079,
    "PCU1_Status1": 0x0808D0A7,
    "PCU1_Status2": 0x0809D0A7,
    "PCU2_Status1": 0x0808D0A8,
    "PCU2_Status2": 0x0809D0A8,
    "Pedals_Position": 0x0810D021,  # of a vehicle with pedals on CAN alone
}
PERIODS_MS = {
    "ARD2_SteeringWheel": 100,
    "BMS_Status": 500,
    "BMS_Temperatures": 500,
    "IMU_Acceleration": 10,
    "IMU_AngularRate": 10,
    "IMU_Attitude": 10,
    "PCU1_Status1": 500,
    "PCU2_Status1": 500,
    "Pedals_Position": 20,
}
ECO, NORMAL, TURBO, SAFETY = range(4)
INTRUDER_MARK = 0x5A  # in the command's unused B4: a command frame that is not the gateway's
BEAT = 0x18FFAA55  # of nobody: its gaps tell that this machine stood still

_EXTENDED = 0x8000_0000
_ERROR = 0x2000_0000
_SO_TIMESTAMPNS = 35
_SO_RCVBUFFORCE = 33
_CAN_RAW_ERR_FILTER = 2


def raw(physical: float, factor: float, offset: float = 0.0) -> int:
    """The code that is nearest to a physical value."""
    return int((physical - offset) / factor + 0.5)


def percent(physical: float) -> int:
    """The command's byte for a percentage: 0.39 a step, nearest, never beyond a byte."""
    return min(255, raw(physical, 0.39))


# --- frames that the vehicle sends -----------------------------------------------------------

BMS_HEALTHY = {
    "PackVoltage": 52.0, "SOC": 80, "CellOvervoltage": 0, "CellUndervoltage": 0,
    "DischargeOvercurrent": 0, "TemperatureImbalance": 0, "Overtemperature": 0,
    "Undertemperature": 0, "VoltageImbalance": 0, "InternalFault": 0, "BatteryState": 2,
}  # fmt: skip
STATUS1_HEALTHY = {
    "VoltageLevel": 3, "CurrentLevel": 1, "TemperatureProtectLevel": 0, "FocMode": 1,
    "StatusCode": 0, "ControllerTemperature": 40, "MotorTemperature": 50,
}  # fmt: skip
STATUS2_HEALTHY = {
    "BatteryVoltage": 52.0,
    "BatteryCurrent": 10.0,
    "PhaseCurrent": 20.0,
    "MotorSpeed": 0,
}
ARD2_HEALTHY = {"SteeringAngle": 0.0, "WheelSpeedFL": 20.0, "WheelSpeedFR": 20.0}
TEMPERATURES_HEALTHY = {f"PackTemperature{number}": 25 for number in range(1, 6)}


def bms_status(values: dict, life: int) -> bytes:
    volts = raw(values["PackVoltage"], 0.01)
    b6 = (
        values["CellOvervoltage"]
        | values["CellUndervoltage"] << 2
        | values["DischargeOvercurrent"] << 6
    )
    b7 = (
        values["TemperatureImbalance"]
        | values["Overtemperature"] << 2
        | values["Undertemperature"] << 4
        | values["VoltageImbalance"] << 6
        | values["InternalFault"] << 7
    )
    b8 = values["BatteryState"] | life << 7
    return bytes([volts & 255, volts >> 8, 0, 0, values["SOC"], b6, b7, b8])


def bms_temperatures(values: dict) -> bytes:
    return bytes([values[name] + 50 for name in TEMPERATURES_HEALTHY] + [0, 0, 0])


def steering_wheel(values: dict) -> bytes:
    return struct.pack(
        "<HHHxx",
        raw(values["SteeringAngle"], 0.003, -90),
        raw(values["WheelSpeedFL"], 0.001),
        raw(values["WheelSpeedFR"], 0.001),
    )


def status1(values: dict, echo: bytes) -> bytes:
    """echo: the three bytes that the controller says it obeys."""
    b4 = (
        values["VoltageLevel"]
        | values["CurrentLevel"] << 3
        | values["TemperatureProtectLevel"] << 5
        | values["FocMode"] << 7
    )
    return echo[:3] + struct.pack(
        "<BHBB",
        b4,
        values["StatusCode"],
        values["ControllerTemperature"],
        values["MotorTemperature"],
    )


def status2(values: dict) -> bytes:
    return struct.pack(
        "<HhhH",
        raw(values["BatteryVoltage"], 1 / 128),
        round(values["BatteryCurrent"] * 16),
        round(values["PhaseCurrent"] * 16),
        values["MotorSpeed"],
    )


IMU_AT_REST = {
    "IMU_Acceleration": struct.pack("<HHHxx", *[raw(0, 0.01, -78.48)] * 3),
    "IMU_AngularRate": struct.pack("<HHHxx", *[raw(0, 0.0078125, -245)] * 3),
    "IMU_Attitude": struct.pack("<HHHxx", *[raw(0, 0.058, -85)] * 3),
}


# --- the command -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Command:
    power_mode: int
    reverse: int
    regen: int
    cut: int
    throttle: int  # the byte, 0.39 % a step
    brake: int
    speed_limit: int
    power_limit: int
    unused: int

    @classmethod
    def of(cls, data: bytes) -> "Command":
        b1, throttle, brake, b4, speed, power = struct.unpack("<BBBBHH", data)
        return cls(
            b1 >> 2 & 3, b1 >> 4 & 1, b1 >> 5 & 1, b1 >> 7 & 1,
            throttle, brake, speed, power, (b1 & 0b0100_0011) | b4 << 8,
        )  # fmt: skip


def safe_frame(speed_limit: int = 12000, reverse: int = 0, cut: int = 0) -> bytes:
    """ZERO_TORQUE, or with cut=1 POWER_CUT, byte by byte."""
    return struct.pack("<BBBBHH", 0x0C | reverse << 4 | cut << 7, 0, 0, 0, speed_limit, 0)


ZERO_TORQUE = bytes.fromhex("0C000000E02E0000")
POWER_CUT = bytes.fromhex("8C000000E02E0000")


def intruding(reverse: int = 0) -> bytes:
    return bytes([0x0C | reverse << 4, 0, 0, INTRUDER_MARK, 0xE0, 0x2E, 0, 0])


# --- the socket ------------------------------------------------------------------------------


def packed(can_id: int, data: bytes) -> bytes:
    return struct.pack("<IB3x8s", can_id | _EXTENDED, len(data), data)


def error_packed(classes: int, controller: int = 0, counters: tuple[int, int] = (0, 0)) -> bytes:
    """An error frame as a driver would report it (linux/can/error.h)."""
    data = bytes([0, controller, 0, 0, 0, 0, *counters])
    return struct.pack("<IB3x8s", classes | _ERROR, 8, data)


def unpacked(frame: bytes) -> tuple[int, bytes]:
    """Identifier (an error frame's is negative) and data."""
    can_id, length, data = struct.unpack("<IB3x8s", frame)
    if can_id & _ERROR:
        return -(can_id & 0x1FFF_FFFF), data[:length]
    return can_id & 0x1FFF_FFFF, data[:length]


def open_bus(filters: list[tuple[int, int]] | None = None, channel: str = CHANNEL) -> socket.socket:
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    if filters is not None:
        packed_filters = b"".join(struct.pack("<II", *one) for one in filters)
        bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed_filters)
    bus.bind((channel,))
    return bus


def open_recorder() -> socket.socket:
    """Everything on the bus with the kernel's stamps, and room for half a minute of it."""
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, 32 << 20)
    bus.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    bus.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, 0x1FFF_FFFF)
    bus.bind((CHANNEL,))
    bus.setblocking(False)
    return bus
