"""Nodes on the bus: when each message is sent, and its values from the state of the vehicle."""

import heapq
import itertools
import random
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

from vcu_gateway.core.codec import Codec, MessageCodec, Reason
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.schedule import Schedule
from vcu_gateway.simulator.motor import voltage_level
from vcu_gateway.simulator.pedals import PedalNode
from vcu_gateway.simulator.vehicle import LEFT, RIGHT, Vehicle
from vcu_gateway.units import NS_PER_MS

Values = Mapping[str, float]
Source = Callable[[int], Values]
"""Values of the next frame; the argument is how many frames of it were sent before."""

_KM_H_PER_M_S = 3.6
_GRAVITY_M_S2 = 9.81

# Standard deviations of the sensors' noise.
_STEERING_NOISE_DEG = 0.02
_WHEEL_SPEED_NOISE_SHARE = 0.001
_PACK_VOLTAGE_NOISE_V = 0.01

# What the IMU measures along X, Y and Z, and the standard deviation of its noise: m/s², °/s and °.
_INERTIAL: Mapping[str, tuple[Callable[[Vehicle], Sequence[float]], float]] = {
    "Acceleration": (
        lambda v: (v.acceleration_m_s2, v.lateral_acceleration_m_s2, _GRAVITY_M_S2),
        0.03,
    ),
    "AngularRate": (lambda v: (v.roll_rate_deg_s, v.pitch_rate_deg_s, v.yaw_rate_deg_s), 0.05),
    "Attitude": (lambda v: (v.roll_deg, v.pitch_deg, v.heading_deg), 0.03),
}

# The five packs: the middle one is the warmest.
_PACK_OFFSETS_K = (-1.0, -0.3, 0.4, 0.0, -0.7)


def sources(vehicle: Vehicle, noise: random.Random) -> Mapping[str, Source]:
    """The source of each message's values, by message name."""
    sources: dict[str, Source] = {
        "ARD2_SteeringWheel": partial(_steering_wheel, vehicle, noise),
        "BMS_Status": partial(_bms_status, vehicle, noise),
        "BMS_Temperatures": partial(_bms_temperatures, vehicle),
    }
    for quantity in _INERTIAL:
        sources[f"IMU_{quantity}"] = partial(_inertial, quantity, vehicle, noise)
    for controller in (LEFT, RIGHT):
        sources[f"{controller}_Status1"] = partial(_status1, vehicle, controller)
        sources[f"{controller}_Status2"] = partial(_status2, vehicle, controller)
    return sources


def _steering_wheel(vehicle: Vehicle, noise: random.Random, _: int) -> Values:
    return {
        "SteeringAngle": vehicle.steering_deg + noise.gauss(0, _STEERING_NOISE_DEG),
        "WheelSpeedFL": _wheel_speed_km_h(vehicle.left_speed_m_s, noise),
        "WheelSpeedFR": _wheel_speed_km_h(vehicle.right_speed_m_s, noise),
    }


def _wheel_speed_km_h(speed_m_s: float, noise: random.Random) -> float:
    """Speed without sign: the sensor has no direction."""
    return abs(speed_m_s) * _KM_H_PER_M_S * (1 + noise.gauss(0, _WHEEL_SPEED_NOISE_SHARE))


def _bms_status(vehicle: Vehicle, noise: random.Random, count: int) -> Values:
    battery = vehicle.battery
    return {
        "PackVoltage": battery.voltage_v + noise.gauss(0, _PACK_VOLTAGE_NOISE_V),
        "SOC": battery.soc_pct,
        "CellOvervoltage": 0,
        "CellUndervoltage": battery.undervoltage_level,
        "DischargeOvercurrent": 0,
        "TemperatureImbalance": 0,
        "Overtemperature": 0,
        "Undertemperature": 0,
        "VoltageImbalance": 0,
        "InternalFault": 0,
        "BatteryState": battery.state,
        "ErrorCode": 0,
        "LifeSignal": count % 2,
    }


def _bms_temperatures(vehicle: Vehicle, _: int) -> Values:
    middle_c = vehicle.battery.temperature_c
    return {
        f"PackTemperature{number}": middle_c + offset_k
        for number, offset_k in enumerate(_PACK_OFFSETS_K, start=1)
    }


def _inertial(quantity: str, vehicle: Vehicle, noise: random.Random, _: int) -> Values:
    measured, deviation = _INERTIAL[quantity]
    axes = zip("XYZ", measured(vehicle), strict=True)
    return {f"{quantity}{axis}": value + noise.gauss(0, deviation) for axis, value in axes}


def _status1(vehicle: Vehicle, controller: str, _: int) -> Values:
    motor = vehicle.motors[controller]
    return {
        "PowerMode": motor.order.power_mode,
        "MotorReverse": motor.order.motor_reverse,
        "RegenBrake": motor.order.regen_brake,
        "PowerCut": motor.order.power_cut,
        "Throttle": motor.order.throttle_pct,
        "Brake": motor.order.brake_pct,
        "VoltageLevel": voltage_level(vehicle.battery.voltage_v),
        "CurrentLevel": motor.current_level,
        "TemperatureProtectLevel": motor.temperature_protect_level,
        "FocMode": 1,
        "StatusCode": 0,
        "ControllerTemperature": motor.controller_c,
        "MotorTemperature": motor.motor_c,
    }


def _status2(vehicle: Vehicle, controller: str, _: int) -> Values:
    """BatteryCurrent is positive while the motor draws, negative while it regenerates."""
    motor = vehicle.motors[controller]
    voltage_v = vehicle.battery.voltage_v
    return {
        "BatteryVoltage": voltage_v,
        "BatteryCurrent": motor.power_w / voltage_v,
        "PhaseCurrent": motor.phase_current_a,
        "MotorSpeed": abs(motor.speed_rpm),
    }


ANSWER_DELAY_NS = 1_000_000
"""From a command to the controller's Status2."""

# Successive messages start so far apart: one frame at 250 kbit/s takes 0.6 ms.
_PHASE_NS = 1_000_000


class NodeFrame(NamedTuple):
    """A frame to send.

    Attributes:
        can_id: 29-bit identifier; data: eight bytes, unless a transform made it others.
        message: its name in the protocol.
        due_ns: when it leaves.
        seal: what its node does last: a checksum, where the message has one; `bytes` is nothing.
    """

    can_id: int
    data: bytes
    message: str
    due_ns: int
    seal: Callable[[bytes], bytes] = bytes


Transform = Callable[[NodeFrame], Iterable[NodeFrame]]
"""Changes of a frame between its node and the bus.

Nothing returned is a lost frame (or a silent node), two are a duplicate, other data a frozen,
overridden or corrupted one, a later due_ns a delayed one.
"""


class VehicleFault(Protocol):
    """Something that is broken for a while."""

    def next_due_ns(self) -> int:
        """Time at which `due` has something to do; far in the future where nothing is left."""

    def due(self, vehicle: Vehicle, now_ns: int) -> Iterable[NodeFrame]:
        """Break or repair the vehicle; the frames that no node of it sends."""

    def transform(self, frame: NodeFrame) -> Iterable[NodeFrame]:
        """As a `Transform`."""


@dataclass(slots=True)
class _Sender:
    """One cyclic message with its values and the number of frames sent."""

    codec: MessageCodec
    source: Source
    seal: Callable[[bytes], bytes] = bytes
    count: int = 0

    def frame(self, due_ns: int) -> NodeFrame:
        data = self.seal(self.codec.encode(self.source(self.count)))
        self.count += 1
        return NodeFrame(self.codec.spec.can_id, data, self.codec.spec.name, due_ns, self.seal)


class Nodes:
    """BMS, IMU, ARD2 and both motor controllers, and a pedal node where there is one.

    Cyclic messages leave on fixed grids with the protocol's periods; a grid point missed by
    more than half a period is skipped. A controller's Status2 answers each command and is
    never sent otherwise.

    Attributes:
        vehicle: what the nodes measure and move; `due` and `receive` advance it.
    """

    def __init__(
        self,
        codec: Codec,
        vehicle: Vehicle,
        noise: random.Random,
        faults: Sequence[VehicleFault] = (),
        pedals: PedalNode | None = None,
    ) -> None:
        """Start the grids at vehicle.start_ns; each frame passes the faults in turn."""
        self._codec = codec
        self.vehicle = vehicle
        self._faults = tuple(faults)
        self._transforms = tuple(fault.transform for fault in faults)
        self._senders = _senders(codec, sources(vehicle, noise))
        if pedals is not None:
            foot = self._senders[pedals.message]
            foot.source = lambda count: pedals.values(vehicle.elapsed_s, count)
            foot.seal = pedals.seal
        self._controllers = {message_name(name): name for name in vehicle.motors}
        answers = {f"{controller}_Status2" for controller in vehicle.motors}
        self._grids = _grids(
            [sender for name, sender in self._senders.items() if name not in answers],
            vehicle.start_ns,
        )
        self._answers: deque[tuple[int, _Sender]] = deque()
        self._outgoing: list[tuple[int, int, NodeFrame]] = []
        self._sequence = itertools.count()

    @property
    def cyclic_messages(self) -> tuple[str, ...]:
        """Names of the messages that are sent by themselves."""
        return tuple(sender.codec.spec.name for _, sender in self._grids)

    @property
    def command_ids(self) -> tuple[int, ...]:
        """Identifiers of the commands that the controllers listen to."""
        return tuple(self._codec.by_name[name].spec.can_id for name in self._controllers)

    def receive(self, can_id: int, data: bytes | bytearray, now_ns: int) -> str | None:
        """Take in an extended data frame; the command's name, None where it is no command."""
        found = self._codec.find(Frame(can_id, data, now_ns))
        if isinstance(found, Reason) or found.spec.name not in self._controllers:
            return None
        controller = self._controllers[found.spec.name]
        self._advance(now_ns)
        values = dict(zip(found.spec.signal_names, found.decode(data).values, strict=True))
        self.vehicle.command(controller, values, now_ns)
        answer = self._senders[f"{controller}_Status2"]
        self._answers.append((now_ns + ANSWER_DELAY_NS, answer))
        return found.spec.name

    def next_due_ns(self) -> int:
        """Time at which `due` has something again."""
        times_ns = [schedule.next_deadline_ns for schedule, _ in self._grids]
        times_ns += [fault.next_due_ns() for fault in self._faults]
        times_ns += [due_ns for due_ns, _ in self._answers]
        times_ns += [due_ns for due_ns, _, _ in self._outgoing]
        return min(times_ns)

    def due(self, now_ns: int) -> list[NodeFrame]:
        """The frames to send now, the earliest due first."""
        self._advance(now_ns)
        for schedule, sender in self._grids:
            tick = schedule.due(now_ns)
            if tick is not None:
                self._hand_over(sender.frame(tick.deadline_ns))
        while self._answers and self._answers[0][0] <= now_ns:
            due_ns, sender = self._answers.popleft()
            self._hand_over(sender.frame(due_ns))
        leaving: list[NodeFrame] = []
        while self._outgoing and self._outgoing[0][0] <= now_ns:
            leaving.append(heapq.heappop(self._outgoing)[2])
        for frame in leaving:
            if frame.message in self._controllers:  # the controllers also obey a foreign node
                self.receive(frame.can_id, frame.data, now_ns)
        return leaving

    def _advance(self, now_ns: int) -> None:
        """Advance the vehicle; break and repair what is due on the way."""
        for fault in self._faults:
            for frame in fault.due(self.vehicle, now_ns):
                self._hand_over(frame)
        self.vehicle.advance(now_ns)

    def _hand_over(self, frame: NodeFrame) -> None:
        frames: Iterable[NodeFrame] = (frame,)
        for transform in self._transforms:
            frames = [changed for each in frames for changed in transform(each)]
        for each in frames:
            heapq.heappush(self._outgoing, (each.due_ns, next(self._sequence), each))


def _senders(codec: Codec, known: Mapping[str, Source]) -> dict[str, _Sender]:
    """What sends each message; the ones that the vehicle models first, they keep their phases.

    In a message that it does not model each signal has its value nearest to 0.
    """
    names = [m.name for m in codec.protocol.messages if m.sender != OWN_NODE]
    names.sort(key=lambda name: name not in known)
    return {name: _Sender(codec.by_name[name], known.get(name, lambda _: {})) for name in names}


def _grids(senders: Iterable[_Sender], start_ns: int) -> list[tuple[Schedule, _Sender]]:
    """A schedule for every message that has a period, in the protocol's order."""
    grids: list[tuple[Schedule, _Sender]] = []
    for sender in senders:
        period_ms = sender.codec.spec.period_ms
        if period_ms is not None:
            first_ns = start_ns + len(grids) * _PHASE_NS
            grids.append((Schedule(first_ns, period_ms * NS_PER_MS), sender))
    return grids
