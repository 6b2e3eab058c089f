"""A gateway and the simulated vehicle in simulated time, driven and broken by a script.

Nothing here knows a clock: the same script gives the same calls into the core, to the nanosecond.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from tests.core.simulated_drive import CODEC, MS, data
from vcu_gateway import simulator
from vcu_gateway.core import calls
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand, PowerMode, RequestResult
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.simulator import faults
from vcu_gateway.simulator.nodes import NodeFrame, VehicleFault
from vcu_gateway.simulator.pedals import Foot
from vcu_gateway.simulator.scenario import FAULTS, PROTOCOL
from vcu_gateway.simulator.vehicle import Vehicle

START_NS = 5_000 * MS
TICK_PHASE_NS = 7 * MS  # on no grid of the vehicle's
ECHO_DELAY_NS = MS // 2
END_TICKS_AT_MOST = 20
Step = dict[str, Any]
"""As a step of a scenario, without its time: {"fault": "silence", "of": "BMS"}."""

RELEASED = ControllerDemand()
CRUISE = ControllerDemand(throttle_pct=30, power_mode=PowerMode.NORMAL)
# The inertial unit is nine tenths of the traffic, and nothing but an alarm hangs on it.
QUIET: Step = {"fault": "silence", "of": "IMU"}


class ChangingFault:
    """What is broken about the vehicle now; the script changes it."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._broken: list[faults.Fault] = []

    def next_due_ns(self) -> int:
        return faults.NEVER_NS

    def due(self, vehicle: Vehicle, now_ns: int) -> Iterable[NodeFrame]:
        return ()

    def change(self, vehicle: Vehicle, steps: Iterable[Step]) -> None:
        for fault in self._broken:
            fault.change(vehicle, False)
        self._broken = [_fault(step, self._codec) for step in steps]
        for fault in self._broken:
            fault.change(vehicle, True)

    def transform(self, frame: NodeFrame) -> Iterable[NodeFrame]:
        frames: Iterable[NodeFrame] = (frame,)
        for fault in self._broken:
            frames = [changed for each in frames for changed in fault.transform(each)]
        return frames


def _fault(step: Step, codec: Codec) -> faults.Fault:
    context = {PROTOCOL: codec.protocol}
    model = FAULTS[step["fault"]].model_validate({"at_s": 0, **step}, context=context)
    return model.broken(codec)


class Pressed:
    """Travel of a pedal (%), whatever time it is; the script changes it."""

    def __init__(self) -> None:
        self.pct = 0.0

    def at(self, _: float) -> float:
        return self.pct


class ScriptedDrive:
    """One drive; its attributes are what a script changes while it goes on.

    Attributes:
        gateway: the core, or what records the calls into it.
        demanded: the driver's demand, offered 1 ms before every tick; None: no demand.
        ttl_ms: of these demands; source: whose they are.
        accepted: the bus takes our frames, of the controllers `taken`; echo: they come back.
        connected: frames of the vehicle reach the gateway.
        throttle, brake: what the foot presses, where there are pedals on CAN.
        after_tick: called when a tick's frames were sent, as the gateway's observer is.
    """

    def __init__(
        self,
        gateway: Gateway,
        start_ns: int = START_NS,
        *,
        quiet: bool = True,
        soc_pct: float = 80.0,
        faults: Iterable[VehicleFault] = (),
        codec: Codec = CODEC,
    ) -> None:
        self.gateway = gateway
        self.start_ns = self.now_ns = start_ns
        self.demanded: ControllerDemand | Mapping[str, ControllerDemand] | None = RELEASED
        self.ttl_ms = 200
        self.source = "driver"
        self.accepted = self.echo = self.connected = True
        self.taken: tuple[str, ...] = CONTROLLERS
        self.result: TickResult | None = None
        self.after_tick: Callable[[TickResult], None] = lambda result: None
        self._quiet = [QUIET] if quiet else []
        self._fault = ChangingFault(codec)
        self.throttle, self.brake = Pressed(), Pressed()
        self.nodes = simulator.build(
            codec,
            start_ns,
            soc_pct=soc_pct,
            faults=[self._fault, *faults],
            pedals=gateway.settings.pedals,
            # No curves over time: a script presses and lets go while it runs.
            foot=Foot(self.throttle, self.brake),  # type: ignore[arg-type]
        )
        self.tick_ns = start_ns + TICK_PHASE_NS
        self._echoes: list[Frame] = []
        self.sequence = 0
        self.break_with()

    # The vehicle and the bus.

    def break_with(self, *steps: Step) -> None:
        """Break the vehicle so, and mend all else."""
        self.nodes.vehicle.advance(self.now_ns)
        self._fault.change(self.nodes.vehicle, [*self._quiet, *steps])

    @contextmanager
    def broken(self, *steps: Step) -> Iterator[None]:
        """Broken so for the block."""
        self.break_with(*steps)
        yield
        self.break_with()

    def receive(self, can_id: int, payload: bytes, at_ns: int | None = None, **kind: bool) -> None:
        """A frame that nobody of the vehicle sent."""
        self.gateway.receive(Frame(can_id, payload, at_ns or self.now_ns, **kind))

    def say(
        self, name: str, raws: Mapping[str, int] | None = None, at_ns: int | None = None
    ) -> None:
        """A healthy frame of a node with some codes replaced."""
        self.receive(CODEC.by_name[name].spec.can_id, data(name, raws), at_ns)

    def error_frame(self, classes: int, controller_bits: int = 0) -> None:
        """An error frame of the CAN controller."""
        payload = bytes((0, controller_bits, 0, 0, 0, 0, 0, 0))
        self.receive(classes, payload, extended=False, error=True)

    def lose_link(self) -> None:
        """The interface is down or gone."""
        self.connected = self.accepted = False
        self.gateway.apply(calls.LoseLink(self.now_ns))

    def open_link(self, state: LinkState = LinkState.UP, carrier: bool | None = None) -> None:
        """The interface was opened, now."""
        self.connected = self.accepted = True
        known = None if carrier is None else Carrier(carrier, self.now_ns)
        self.gateway.apply(calls.OpenLink(LinkStatus(state, self.now_ns), known, self.now_ns))

    def carry(self, present: bool) -> None:
        """The carrier of the open interface came or went."""
        self.gateway.apply(calls.ChangeCarrier(Carrier(present, self.now_ns)))

    # Time.

    def run(self, duration_ms: float) -> None:
        """Let time go by, with a tick every period."""
        end_ns = self.now_ns + round(duration_ms * MS)
        while self.tick_ns <= end_ns:
            self.tick()
        self.wait_until(end_ns)

    def ticks(self, count: int) -> None:
        """Tick so often."""
        for _ in range(count):
            self.tick()

    def end(self, *refused: int) -> None:
        """Asked to end; tick until the gateway has, as the loop does.

        The bus takes no frames of the ticks `refused`, of which the first is 1.
        """
        self.gateway.apply(calls.Terminate())
        for number in range(1, END_TICKS_AT_MOST + 1):
            self.accepted = number not in refused
            self.tick()
            if self.gateway.finished:
                return
        raise AssertionError("no end")

    def tick(self, late_ns: int = 0) -> None:
        """The next tick of the grid, or so much later; ticks that were missed are skipped."""
        at_ns = self.tick_ns + late_ns
        self.wait_until(at_ns - MS)
        if self.demanded is not None:
            self.offer(self.demanded)
        self.wait_until(at_ns)
        self.tick_now()
        period_ns = self.gateway.settings.period_ns
        while self.tick_ns <= at_ns:
            self.tick_ns += period_ns

    def tick_now(self) -> None:
        """A tick at this instant, on no grid."""
        self.result = self.gateway.tick(self.now_ns)
        for frame in self.result.frames:
            accepted = self.accepted and frame.controller in self.taken
            self.gateway.apply(calls.NoteSent(frame, accepted, self.now_ns))
            if accepted:
                self.nodes.receive(frame.can_id, frame.data, self.now_ns)
                at_ns = self.now_ns + ECHO_DELAY_NS
                self._echoes.append(Frame(frame.can_id, frame.data, at_ns, own_echo=True))
        self.after_tick(self.result)
        if self.gateway.finished and not self.gateway.requests.terminating:
            raise AssertionError("the loop would have ended here")

    def wait_until(self, at_ns: int) -> None:
        """Let time go by without a tick: the vehicle sends, our frames come back."""
        while (due_ns := self._next_due_ns()) <= at_ns:
            self.now_ns = max(self.now_ns, due_ns)
            self._hand_over()
        self.now_ns = max(self.now_ns, at_ns)

    def _next_due_ns(self) -> int:
        echo_ns = self._echoes[0].arrival_ns if self._echoes else faults.NEVER_NS
        return min(self.nodes.next_due_ns(), echo_ns)

    def _hand_over(self) -> None:
        while self._echoes and self._echoes[0].arrival_ns <= self.now_ns:
            frame = self._echoes.pop(0)
            if self.echo and self.connected:
                self.gateway.receive(frame)
        for sent in self.nodes.due(self.now_ns):
            if self.connected:
                self.receive(sent.can_id, sent.data, sent.due_ns)

    # The driver.

    def offer(
        self, demanded: ControllerDemand | Mapping[str, ControllerDemand], **changes: Any
    ) -> RequestResult:
        """One demand; `changes` of its fields, such as ttl_ms, sequence or made_ns."""
        self.sequence += 1
        both = (
            dict.fromkeys(CONTROLLERS, demanded)
            if isinstance(demanded, ControllerDemand)
            else demanded
        )
        demand = Demand(self.source, self.sequence, self.ttl_ms, both)
        return self.gateway.apply(calls.Offer(replace(demand, **changes), self.now_ns))

    def demand(self, **changes: Any) -> None:
        """Demand this of both controllers from now on."""
        self.demanded = replace(CRUISE, **changes)

    def arm(self) -> RequestResult:
        return self.gateway.apply(calls.Arm(self.now_ns))

    def reset(self, level: FaultClass = FaultClass.SERVICE) -> RequestResult:
        return self.gateway.apply(calls.Reset(level, self.now_ns))

    def until(self, mode: Mode, within_ms: int = 6000) -> None:
        """Tick until this mode."""
        for _ in range(within_ms // 50):
            if self.gateway.supervisor.mode is mode:
                return
            self.tick()
        raise AssertionError(f"no {mode.value}: {self.gateway.why(self.now_ns).sentence()}")

    def start_driving(self, **changes: Any) -> None:
        """From wherever it is to throttle: reset, arm, demand."""
        self.demanded = RELEASED
        self.break_with()
        for _ in range(100):
            mode = self.gateway.supervisor.mode
            if mode is Mode.ACTIVE:
                break
            if mode is Mode.FAULT:
                self.reset()
            elif mode is Mode.STANDBY and not self.gateway.requests.against_arming(self.now_ns):
                self.arm()
            self.tick()
        self.demand(**changes)
        self.run(1000)
