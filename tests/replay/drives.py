"""Drives in simulated time, recorded into files: a gateway, a vehicle and a driver."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tests.recording.drive_writer import DriveWriter
from vcu_gateway import config as configuration
from vcu_gateway import simulator
from vcu_gateway.core import calls
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand, PowerMode
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, packaged
from vcu_gateway.recording.tap import Hello, Tap, TappedGateway
from vcu_gateway.simulator.nodes import VehicleFault

MS = 1_000_000
BEGIN_NS = 5_000_000 * MS
WALL_NS = 1_795_000_000_000_000_000


def _codec(path: Path) -> Codec:
    return Codec(dbc.with_aliases(dbc.load(path), DEFAULT_ALIASES))


CODEC = _codec(packaged("vcu.dbc"))


class SimulatedDrive:
    """A gateway that is recorded, among the simulator's nodes.

    Attributes:
        throttle_pct, brake_pct and so on: demanded every tick; None: no demand at all.
    """

    def __init__(
        self,
        folder: Path,
        config: str = "",
        segment_s: float = 60.0,
        faults: Sequence[VehicleFault] = (),
        dbc_path: Path | None = None,
    ) -> None:
        path = dbc_path or packaged("vcu.dbc")
        codec = CODEC if dbc_path is None else _codec(path)
        parsed = configuration.parse(config or "bus: {channel: can0}\n", "config.yaml")
        settings = configuration.core_settings(parsed)
        self.now_ns, self.tap = BEGIN_NS, Tap()
        self.gateway = TappedGateway(codec, settings, self.now_ns, self.tap)
        self.nodes = simulator.build(codec, self.now_ns, faults=faults)
        self.demanded: ControllerDemand | None = ControllerDemand()
        self.taken, self.silent = True, set[str]()
        self.change: Callable[[str, bytes], bytes] = lambda name, data: data
        self._sequence = 0
        hello = Hello(
            run="0" * 32,
            boot="",
            channel="can0",
            clock=ClockPair(BEGIN_NS, WALL_NS),
            settings=settings,
            config=config or "bus: {channel: can0}\n",
            config_digest=configuration.digest(parsed),
            dbc=path.read_text(encoding="utf-8"),
            dbc_digest="",
        )
        self.writer = DriveWriter(
            folder, hello.values(), self.gateway, self.now_ns, round(segment_s * 1000) * MS
        )
        self.folder = folder

    def open_link(self) -> None:
        up = LinkStatus(LinkState.UP, self.now_ns)
        self.gateway.apply(calls.OpenLink(up, Carrier(True, self.now_ns), self.now_ns))

    def tick(self, after_ns: int = 50 * MS) -> None:
        """Let time go by, the vehicle speak and the driver ask; decide and send."""
        self.now_ns += after_ns
        while (due_ns := self.nodes.next_due_ns()) <= self.now_ns:
            for one in self.nodes.due(due_ns):
                if one.message not in self.silent:
                    data = self.change(one.message, one.data)
                    self.gateway.receive(Frame(one.can_id, data, due_ns))
        if self.demanded is not None:
            self.offer(self.demanded)
        self.decide()

    def decide(self) -> None:
        now_ns = self.now_ns
        result = self.gateway.tick(now_ns)
        for frame in result.frames:
            self.gateway.apply(calls.NoteSent(frame, self.taken, now_ns))
        for frame in result.frames if self.taken else ():
            self.nodes.receive(frame.can_id, frame.data, now_ns)
            self.gateway.receive(Frame(frame.can_id, frame.data, now_ns, own_echo=True))
        self.writer.after_tick(now_ns)

    def offer(self, demanded: ControllerDemand, source: str = "driver", **changes: Any) -> None:
        self._sequence += 1
        both = dict.fromkeys(CONTROLLERS, demanded)
        demand = Demand(source, self._sequence, 200, both, **changes)
        self.gateway.apply(calls.Offer(demand, self.now_ns))

    def run(self, seconds: float) -> "SimulatedDrive":
        for _ in range(round(seconds * 20)):
            self.tick()
        return self

    def arm(self) -> bool:
        return self.gateway.apply(calls.Arm(self.now_ns)).granted

    def begin(self) -> "SimulatedDrive":
        """Open the link, and come to ACTIVE."""
        self.open_link()
        self.run(3.0)
        assert self.arm(), self.gateway.why(self.now_ns).sentence()
        self.tick()
        return self

    def throttle(self, pct: float, brake_pct: float = 0.0, **more: Any) -> None:
        self.demanded = ControllerDemand(
            throttle_pct=pct, brake_pct=brake_pct, power_mode=PowerMode.NORMAL, **more
        )

    def end(self) -> Path:
        self.writer.close(self.now_ns)
        return self.folder


def ordinary(folder: Path, config: str = "", seconds: float = 20.0, **more: Any) -> Path:
    """A drive that accelerates, brakes with regeneration, and stands again."""
    drive = SimulatedDrive(folder, config, **more).begin()
    for pct, brake_pct in ((40.0, 0.0), (100.0, 0.0), (0.0, 30.0), (15.0, 0.0), (0.0, 0.0)):
        drive.throttle(pct, brake_pct, regen_brake=brake_pct > 0)
        drive.run(seconds / 5)
    return drive.end()


def every_input(folder: Path) -> Path:
    """A drive with every kind of call that a core knows."""
    drive = SimulatedDrive(folder, segment_s=5.0)
    drive.gateway.apply(calls.CountRestarts(1))
    drive.gateway.apply(calls.BeginFrom(None, {"PCU1": False, "PCU2": False}))
    drive.begin()
    drive.throttle(30.0)
    drive.run(4.0)
    gateway = drive.gateway
    drive.offer(ControllerDemand(throttle_pct=500.0), "nobody")  # refused
    drive.offer(ControllerDemand(), "other")  # not the owner
    drive.run(0.3)
    gateway.apply(calls.Disarm(drive.now_ns))
    drive.throttle(0.0)
    drive.run(1.0)
    gateway.apply(calls.Arm(drive.now_ns))
    drive.run(1.0)
    gateway.apply(calls.EndDemand("driver", drive.now_ns))
    drive.run(1.0)
    changed = Settings(throttle_slew_pct_per_s=60.0)
    assert gateway.apply(calls.ReloadSettings(changed)).granted
    drive.run(0.5)
    gateway.apply(calls.EmergencyStop())
    drive.run(2.0)
    gateway.apply(calls.Reset(FaultClass.DRIVER, drive.now_ns))
    drive.run(0.2)
    gateway.apply(calls.Reset(FaultClass.SERVICE, drive.now_ns))
    drive.run(2.0)
    gateway.apply(calls.ChangeCarrier(Carrier(False, drive.now_ns)))
    drive.run(0.2)
    gateway.apply(calls.ChangeCarrier(Carrier(True, drive.now_ns)))
    gateway.receive(Frame(0x0008A7D1, bytes(8), drive.now_ns))  # another sender
    gateway.receive(Frame(0x123, b"\1\2", drive.now_ns, extended=False))
    gateway.receive(Frame(0x18FF0001, b"", drive.now_ns, remote=True))
    gateway.receive(Frame(0x004, bytes((0, 0x10, 0, 0, 0, 0, 0, 0)), drive.now_ns, error=True))
    drive.run(1.0)
    gateway.apply(calls.LoseLink(drive.now_ns))
    drive.taken = False
    drive.run(1.0)
    drive.taken = True
    drive.open_link()
    drive.run(3.0)
    gateway.apply(calls.Reset(FaultClass.SERVICE, drive.now_ns))
    drive.run(2.0)
    gateway.apply(calls.Terminate())
    drive.run(0.5)
    return drive.end()


def _with_bits(data: bytes, byte: int, bits: int) -> bytes:
    return data[:byte] + bytes([data[byte] | bits]) + data[byte + 1 :]


def limits(folder: Path) -> Path:
    """A drive on which most limits are met: slews, codes of the battery, directions, sources."""
    drive = SimulatedDrive(folder, segment_s=20.0).begin()
    drive.throttle(60.0)
    drive.run(4.0)
    drive.change = lambda name, data: _with_bits(data, 5, 0b0100) if name == "BMS_Status" else data
    drive.run(2.0)  # undervoltage 1: power limit
    drive.change = lambda name, data: _with_bits(data, 5, 0b0001) if name == "BMS_Status" else data
    drive.throttle(0.0, 60.0, regen_brake=True)
    drive.run(2.0)  # overvoltage 1: regeneration limit
    drive.change = lambda name, data: data
    drive.throttle(0.0, 20.0, regen_brake=True)
    drive.run(6.0)
    drive.throttle(30.0, speed_limit_rpm=3000.0)
    drive.run(2.0)
    drive.offer(ControllerDemand(), "remote")  # refused: the driver has the demand
    drive.silent = {"BMS_Status"}
    drive.run(1.3)  # late
    drive.silent = {"IMU_Attitude"}
    drive.run(1.0)  # not required
    drive.silent = set()
    drive.throttle(0.0, 60.0)
    drive.run(8.0)
    drive.throttle(0.0, 0.0, motor_reverse=True)
    drive.run(1.0)
    drive.throttle(20.0, 0.0, motor_reverse=True)
    drive.run(2.0)
    return drive.end()


TUNED = """
limits: {power_limit_max_w: 14000, derated_power_w: 4000}
curves:
  power_limit_w: {by_motor_temperature_c: [[95, 14000], [110, 6000], [125, 0]]}
  brake_pct: {by_controller_temperature_c: [[75, 100], [95, 10]]}
  speed_limit_rpm: {by_soc_pct: [[5, 8000], [15, 12000]]}
"""


def tuned(folder: Path) -> Path:
    """A drive with curves, on which motors and controllers become hot and the battery empty."""
    drive = SimulatedDrive(folder, TUNED).begin()
    drive.throttle(20.0, brake_pct=50.0)
    drive.run(2.0)

    def worn(name: str, data: bytes) -> bytes:
        if name.endswith("Status1"):
            return data[:6] + bytes([90, 110])
        return data[:4] + bytes([5]) + data[5:] if name == "BMS_Status" else data

    drive.change = worn
    drive.run(4.0)
    drive.change = lambda name, data: data
    drive.run(6.0)
    return drive.end()
