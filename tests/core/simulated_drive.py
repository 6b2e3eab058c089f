"""Drive in simulated time: a gateway among healthy nodes, and healthy inputs of the rules."""

from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any, Self

from vcu_gateway.core import calls, state
from vcu_gateway.core.causes import CodedSignals, Event
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand, RequestResult
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.plausibility import NO_DEVIATION
from vcu_gateway.core.rules import RuleInputs
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Store
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.protocol import dbc, packaged

MS = 1_000_000
PERIOD_NS = 50 * MS
NOW_NS = 1_000_000 * MS
PROTOCOL = dbc.load(packaged("vcu.dbc"))
CODEC = Codec(PROTOCOL)
RECEIVED = tuple(message.name for message in PROTOCOL.received_by("VCU"))
COMMAND_IDS = {"PCU1": 0x0008A7D0, "PCU2": 0x0008A8D0}

HEALTHY: Mapping[str, Mapping[str, float]] = {
    "BMS_Status": {"PackVoltage": 52, "SOC": 80, "BatteryState": 2},
    "BMS_Temperatures": {f"PackTemperature{number}": 25 for number in range(1, 6)},
    "PCU1_Status1": {"VoltageLevel": 3, "FocMode": 1, "MotorTemperature": 40},
    "PCU2_Status1": {"VoltageLevel": 3, "FocMode": 1, "MotorTemperature": 40},
    "PCU1_Status2": {"BatteryVoltage": 52},
    "PCU2_Status2": {"BatteryVoltage": 52},
}
"""Physical values; what is left out is the code nearest to 0."""

ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")
POWER_CUT = bytes.fromhex("8c000000e02e0000")


def data(message: str, raws: Mapping[str, int] | None = None) -> bytes:
    """A healthy payload with some signals' codes replaced, reserved ones included."""
    codec = CODEC.by_name[message]
    bits = int.from_bytes(codec.encode(HEALTHY.get(message, {})), "little")
    for name, raw in (raws or {}).items():
        for weight, position in enumerate(codec.spec.signal(name).bit_positions()):
            bits &= ~(1 << position)
            bits |= (raw >> weight & 1) << position
    return bits.to_bytes(8, "little")


def raws_of(message: str, codes: Mapping[str, int]) -> dict[str, int]:
    """The entries of this message, from codes by 'Message.Signal'."""
    split = [(name.split("."), raw) for name, raw in codes.items()]
    return {signal: raw for (owner, signal), raw in split if owner == message}


def rule_inputs(
    *,
    codes: Mapping[str, int] | None = None,
    ages_ns: Mapping[str, int] | None = None,
    never: Iterable[str] = (),
    life_frames: int = 1,
    settings: Settings | None = None,
    **facts: Any,
) -> RuleInputs:
    """Inputs in which all is fresh and healthy but what is named here.

    codes: by 'Message.Signal'; ages_ns: of the latest frame; never: messages that never came;
    life_frames: how many battery frames in a row carried one LifeSignal; facts: of `RuleInputs`.
    """
    settings = settings or Settings()
    deadlines = {
        message.name: state.deadlines(message, settings.late_after_ms, settings.stale_after_ms)
        for message in PROTOCOL.received_by("VCU")
    }
    stale_after_ns = {name: one.stale_after_ns for name, one in deadlines.items()}
    store = Store(PROTOCOL.received_by("VCU"), stale_after_ns)
    for name in set(RECEIVED) - set(never):
        age_ns = (ages_ns or {}).get(name, 1)
        lives = (1, *(0,) * life_frames) if name == "BMS_Status" else (None,)
        for life in lives:
            raws = raws_of(name, codes or {}) | ({} if life is None else {"LifeSignal": life})
            store.put(name, CODEC.by_name[name].decode(data(name, raws)), NOW_NS - age_ns)
    late_after_ns = {name: one.late_after_ns for name, one in deadlines.items()}
    ordinary: dict[str, Any] = {
        "link": LinkStatus(LinkState.UP, 0),
        "coded": CodedSignals(),
        "history": {},
        "observed": NO_DEVIATION,
        "passive_ns": 0,
        "tick_late_ns": 0,
        "period_ns": settings.period_ns,
        "unconfirmed_ticks": 0,
        "foreign_sender": None,
        "emergency_stop": False,
        "blocked_by_gate": None,
        "restart_state_failure": None,
    }
    return RuleInputs(store.snapshot(NOW_NS), settings, late_after_ns, **(ordinary | facts))


class Drive:
    """A gateway among healthy nodes, one tick of simulated time after the other.

    Attributes that break something:
        codes: codes by 'Message.Signal' in every frame from now on.
        silent: messages that do not come.
        echo: our frames come back; accepted: the bus takes them; taken: those of these
            controllers alone.
        demanded: the driver's demand for both controllers every tick; None: no demand.
        ttl_ms: of these demands.
    """

    def __init__(self, **settings: Any) -> None:
        self.now_ns = NOW_NS
        self.gateway = Gateway(CODEC, Settings(**settings), self.now_ns)
        self.codes: dict[str, int] = {}
        self.silent: set[str] = set()
        self.echo = self.accepted = True
        self.taken = list(CONTROLLERS)
        self.demanded: ControllerDemand | None = ControllerDemand()
        self.ttl_ms = 200
        self.events: list[Event] = []
        self.result: TickResult | None = None
        self._sequence = self._life = 0
        self._throttles = dict.fromkeys(CONTROLLERS, 0)

    @property
    def mode(self) -> Mode:
        return self.gateway.supervisor.mode

    @property
    def sentence(self) -> str:
        """The answer of `why`."""
        return self.gateway.why(self.now_ns).sentence()

    @property
    def commands(self) -> list[bytes]:
        """The bytes of the last tick's frames."""
        return [] if self.result is None else [frame.data for frame in self.result.frames]

    def receive(self, name: str, at_ns: int | None = None) -> None:
        """One frame of a node, as everything is now."""
        raws = raws_of(name, self.codes)
        if name == "BMS_Status":
            self._life ^= 1
            raws = {"LifeSignal": self._life} | raws
        elif name.endswith("Status1"):
            raws = {"Throttle": self._throttles[name[:4]]} | raws
        at_ns = self.now_ns if at_ns is None else at_ns
        frame = Frame(CODEC.by_name[name].spec.can_id, data(name, raws), at_ns)
        self.gateway.receive(frame)

    def receive_foreign(self, controller: str = "PCU1") -> None:
        """Somebody else's command to a controller."""
        frame = Frame(COMMAND_IDS[controller], ZERO_TORQUE, self.now_ns)
        self.gateway.receive(frame)

    def open_link(self, at_ns: int | None = None) -> None:
        """The interface was opened then, or now, without a word on its carrier."""
        at_ns = self.now_ns if at_ns is None else at_ns
        self.gateway.apply(calls.OpenLink(LinkStatus(LinkState.UP, at_ns), None, at_ns))

    def tick(self, after_ns: int = PERIOD_NS) -> TickResult:
        """Let time go by, the nodes speak and the gateway decide; then send."""
        before_ns, self.now_ns = self.now_ns, self.now_ns + after_ns
        for message in PROTOCOL.received_by("VCU"):
            if message.name not in self.silent:
                self._speak(message.name, (message.period_ms or 0) * MS, before_ns)
        if self.demanded is not None:
            self.offer(self.demanded)
        self.result = result = self.gateway.tick(self.now_ns)
        self.events += result.events
        for frame in result.frames:
            accepted = self.accepted and frame.controller in self.taken
            self.gateway.apply(calls.NoteSent(frame, accepted, self.now_ns))
            if accepted:
                self._throttles[frame.controller] = frame.data[1]
            if accepted and self.echo:
                echo = Frame(frame.can_id, frame.data, self.now_ns, own_echo=True)
                self.gateway.receive(echo)
        return result

    def _speak(self, name: str, period_ns: int, before_ns: int) -> None:
        """The frames of one message since the last tick; Status2 answers our commands only."""
        if name.endswith("Status2"):
            if self.commands and self.accepted:
                self.receive(name, before_ns + 2 * MS)
            return
        first_ns = (before_ns // period_ns + 1) * period_ns
        for at_ns in range(first_ns, self.now_ns + 1, period_ns):
            self.receive(name, at_ns)

    def turn(self, *speeds_rpm: int) -> None:
        """Both motors turn at this speed, or each at its own, from the next frames on."""
        for name, rpm in zip(CONTROLLERS, speeds_rpm * 2, strict=False):
            self.codes[f"{name}_Status2.MotorSpeed"] = rpm

    def run(self, duration_ms: int) -> TickResult:
        """Tick for so long."""
        for _ in range(duration_ms // 50):
            result = self.tick()
        return result

    def until(self, mode: Mode, within_ms: int = 5000) -> Self:
        """Tick until this mode."""
        for _ in range(within_ms // 50):
            if self.mode is mode:
                return self
            self.tick()
        raise AssertionError(f"no {mode.value} within {within_ms} ms: {self.sentence}")

    def offer(self, demanded: ControllerDemand, **changes: Any) -> RequestResult:
        """One demand of the driver for both controllers."""
        self._sequence += 1
        demand = Demand("driver", self._sequence, self.ttl_ms, dict.fromkeys(CONTROLLERS, demanded))
        return self.gateway.apply(calls.Offer(replace(demand, **changes), self.now_ns))

    def arm(self) -> RequestResult:
        return self.gateway.apply(calls.Arm(self.now_ns))

    def reset(self, level: FaultClass = FaultClass.SERVICE) -> RequestResult:
        return self.gateway.apply(calls.Reset(level, self.now_ns))

    def twin(self) -> Self:
        """A copy that goes its own way; only the protocol is shared."""
        shared = {id(one): one for one in (CODEC, PROTOCOL, *PROTOCOL.messages)}
        return deepcopy(self, shared)


def standby(**settings: Any) -> Drive:
    """A drive in STANDBY that nothing speaks against arming."""
    drive = Drive(**settings).until(Mode.STANDBY)
    drive.run(1500)  # what startup itself left behind is over
    return drive


def active(**settings: Any) -> Drive:
    """A drive in ACTIVE without throttle."""
    drive = standby(**settings)
    answer = drive.arm()
    assert answer.granted, answer.sentence
    drive.tick()
    return drive


def in_mode(mode: Mode, **settings: Any) -> Drive:
    """A drive in this mode in which no cause stands or is held, whatever latched FAULT."""
    if mode is Mode.STARTING:
        drive = Drive(**{"qualify_frames": 100} | settings)
        drive.run(3000)
        return drive
    if mode is Mode.ACTIVE:
        return active(**settings)
    drive = standby(**settings)
    if mode is Mode.FAULT:
        drive.receive_foreign()
        drive.run(1500)
    elif mode is Mode.STOPPING:
        drive.gateway.apply(calls.Terminate())
        drive.tick()
    return drive
