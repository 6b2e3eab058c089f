"""The gateway's core and the simulated vehicle in one process: no bus, no waiting."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from vcu_gateway import simulator
from vcu_gateway.core import calls
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand, PowerMode
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.why import Explanation
from vcu_gateway.simulator.nodes import NodeFrame, Nodes
from vcu_gateway.simulator.scenario import Scenario
from vcu_gateway.simulator.vehicle import Vehicle

S_NS = 1_000_000_000
START_NS = 5 * S_NS
CRUISE = ControllerDemand(throttle_pct=40, power_mode=PowerMode.TURBO)


class Ticked(NamedTuple):
    """One tick: when, s after the start, in which mode, and both frames."""

    at_s: float
    mode: Mode
    frames: tuple[bytes, ...]
    why: Explanation


class Drive(NamedTuple):
    """What the vehicle sent and what the gateway answered."""

    gateway: Gateway
    heard: list[tuple[float, NodeFrame]]
    ticks: list[Ticked]
    reports: list[str]

    def heard_of(self, message: str, from_s: float = 0.0) -> list[tuple[float, NodeFrame]]:
        return [(at, f) for at, f in self.heard if f.message == message and at >= from_s]

    def tick_at(self, at_s: float) -> Ticked:
        """The last tick until then."""
        return [tick for tick in self.ticks if tick.at_s <= at_s][-1]

    def first(self, mode: Mode) -> Ticked:
        return next(tick for tick in self.ticks if tick.mode is mode)


Asked = ControllerDemand | Callable[[float], ControllerDemand]
"""The same all the time, or what is asked at a time, s after the start."""


Watch = Callable[[float, Vehicle], None]
"""Called before each tick with its time, s after the start; it may change the vehicle."""


def drive(
    codec: Codec,
    scenario: Scenario,
    seconds: float,
    asked: Asked | None = CRUISE,
    watch: Watch = lambda *_: None,
    **settings: Any,
) -> Drive:
    """Let a gateway drive the vehicle that the scenario breaks, as it is asked.

    Asked for None, it is armed once, and the pedals of its settings drive.
    """
    now_ns, end_ns = START_NS, START_NS + round(seconds * S_NS)
    bench = asked if isinstance(asked, ControllerDemand) else None
    settings |= {"bench_demand": bench, "auto_arm": bench is not None}
    gateway = Gateway(codec, Settings(**settings), now_ns)
    done = Drive(gateway, [], [], [])
    faults = scenario.faults(codec, START_NS, done.reports.append)
    start = scenario.start
    nodes = simulator.build(
        codec,
        START_NS,
        soc_pct=start.soc_pct,
        battery_resistance_ohm=start.battery_resistance_ohm,
        faults=faults,
        pedals=gateway.settings.pedals,
        foot=scenario.foot,
    )
    tick_ns = now_ns + 7_000_000  # on no grid of the vehicle's
    while now_ns < end_ns:
        now_ns = min(tick_ns, nodes.next_due_ns())
        at_s = (now_ns - START_NS) / S_NS
        for frame in nodes.due(now_ns):
            done.heard.append((at_s, frame))
            gateway.receive(Frame(frame.can_id, frame.data, now_ns))
        if now_ns == tick_ns:
            if asked is None:
                _arm_once(gateway, done, now_ns)
            elif not isinstance(asked, ControllerDemand):
                _ask(gateway, asked(at_s), now_ns)
            watch(at_s, nodes.vehicle)
            done.ticks.append(_tick(gateway, nodes, now_ns, at_s))
            tick_ns += gateway.settings.period_ns
    return done


def _ask(gateway: Gateway, asked: ControllerDemand, now_ns: int) -> None:
    """Make a demand as a driver does, and arm where that can be."""
    demand = Demand("driver", now_ns, 200, dict.fromkeys(CONTROLLERS, asked))
    assert gateway.apply(calls.Offer(demand, now_ns)).granted
    _arm(gateway, now_ns)


def _arm_once(gateway: Gateway, done: Drive, now_ns: int) -> None:
    if all(tick.mode is not Mode.ACTIVE for tick in done.ticks):
        _arm(gateway, now_ns)


def _arm(gateway: Gateway, now_ns: int) -> None:
    if gateway.supervisor.mode is Mode.STANDBY and not gateway.requests.against_arming(now_ns):
        gateway.apply(calls.Arm(now_ns))


def _tick(gateway: Gateway, nodes: Nodes, now_ns: int, at_s: float) -> Ticked:
    result = gateway.tick(now_ns)
    for frame in result.frames:
        gateway.apply(calls.NoteSent(frame, True, now_ns))
        gateway.receive(Frame(frame.can_id, frame.data, now_ns, own_echo=True))
        nodes.receive(frame.can_id, frame.data, now_ns)
    return Ticked(
        at_s, result.mode, tuple(f.data for f in result.frames), gateway.why(result.snapshot.now_ns)
    )


def signals(codec: Codec, data: bytes) -> Mapping[str, float]:
    """A command frame by signal name."""
    command = codec.by_name["VCU_PCU1_Command"]
    return dict(zip(command.spec.signal_names, command.decode(data).values, strict=True))
