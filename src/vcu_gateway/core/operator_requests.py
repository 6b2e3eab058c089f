"""Requests of operators: demand, arming, resetting, emergency stop; granted or refused.

Before a request may change the mode the lateness of the tick is judged: a gateway that was away
in ACTIVE has latched its fault before a request ends the drive in another way.
"""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, Causes, Event, Severity
from vcu_gateway.core.commands import Commander
from vcu_gateway.core.demand import (
    BENCH_SOURCE,
    GRANTED,
    ControllerDemands,
    Demand,
    DemandArbiter,
    Refusal,
    RequestResult,
    directions_differ,
    refused,
)
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.mode_manager import ListenBeforeTalk, ModeManager
from vcu_gateway.core.pedal_frames import PEDALS_SOURCE, PedalDemand, PedalFrames, PedalObservation
from vcu_gateway.core.settings import RESTART_ONLY, Settings, changed, loosened
from vcu_gateway.core.supervisor import FaultClass, Mode, Stimulus, Supervisor
from vcu_gateway.units import NS_PER_MS

RELEASED_MS = 200
"""How long the demanded throttle has to be 0 before arming."""

# After this many unexpected restarts in one drive another one is to be expected.
_RESTARTS_MAX = 2

LISTENING = "listening for another sender of our frames"


class RequestInputs(NamedTuple):
    """Conditions that arming and resetting are judged by, at one instant.

    Attributes:
        emergency_stop: requested since the last tick.
        zero_for_ns: how long every demand had a throttle of 0; None where the last has not.
        reverse_pending: the demanded direction is not the applied one.
        independent_directions: the controllers may have two directions.
        listening: another sender of the gateway's frames may still be heard.
        restarts: unexpected restarts of the gateway in this drive.
        restart_state_failure: why the restart state could not be kept; None where it was.
        speed_pending: the SpeedLimit has not come down to its cap.
    """

    supervisor: Supervisor
    causes: Causes
    emergency_stop: bool
    demanded: ControllerDemands | None
    zero_for_ns: int | None
    reverse_pending: bool
    independent_directions: bool
    listening: bool
    restarts: int
    restart_state_failure: str | None
    speed_pending: bool


class OperatorRequests:
    """Requests as they come, on the ticking thread; each is answered with a `RequestResult`.

    Attributes:
        arbiter: takes demands and knows the one that counts.
        terms: the settings in effect; they say what a demand has to be.
        pedal_frames: demands of pedals on CAN.
        emergency_stop_requested: since the last tick.
        terminating: the gateway is to send safe frames and end.
        restarts: unexpected restarts of this gateway in this drive.
        restart_state_failure: why the restart state could not be kept when that was last tried.
    """

    def __init__(
        self,
        settings: Settings,
        modes: ModeManager,
        commander: Commander,
        listening: ListenBeforeTalk,
        pedal_frames: PedalFrames,
    ) -> None:
        self.pedal_frames = pedal_frames
        self.arbiter = DemandArbiter(settings.bench_demand)
        self.terms = settings
        self.emergency_stop_requested = False
        self.terminating = False
        self.restarts = 0
        self.restart_state_failure: str | None = None
        self._modes = modes
        self._commander = commander
        self._listening = listening

    def offer(self, demand: Demand, now_ns: int) -> RequestResult:
        """Take a demand of a source, or refuse it."""
        self._modes.judge_lateness(now_ns)
        return self._of_pedals(demand.source) or self._take(demand, now_ns)

    def _of_pedals(self, source: str) -> RequestResult | None:
        """Refusal of a source that has the pedals' name while they are on CAN."""
        if source != PEDALS_SOURCE or self.terms.pedals is None:
            return None
        return refused(Refusal.NAME_RESERVED, f"{source} are the configured pedals on CAN")

    def _take(self, demand: Demand, now_ns: int, *, known: bool = True) -> RequestResult:
        before = self.arbiter.current
        if not self.arbiter.fresh(now_ns):
            # It expired between two ticks: a new one does not continue the drive.
            self._modes.apply(Stimulus.DEMAND_EXPIRED, now_ns, "the demand expired")
            self._commander.pedals.interrupted()
        result = self.arbiter.offer(demand, self.terms, now_ns)
        if result.granted:
            self._judge(demand, before, now_ns, known=known)
        return result

    def _judge(self, demand: Demand, before: Demand | None, now_ns: int, *, known: bool) -> None:
        """A granted demand counts from now on, also where another follows before the tick."""
        pedals = self._commander.pedals
        if before is None or before.source != demand.source:
            self._modes.emit(Event("demand_owner", Severity.INFO, {"source": demand.source}))
            if self._modes.supervisor.mode is Mode.ACTIVE:
                pedals.taken_over()
        made_ns = now_ns if demand.made_ns is None else demand.made_ns
        pedals.judge(demand.controllers, made_ns, now_ns, known=known)

    def take_pedal_frames(self, frames: Iterable[Frame], now_ns: int) -> PedalObservation | None:
        """Take each frame of the pedals since the tick before as a demand; what is odd of them."""
        for frame in frames:
            demand = self.pedal_frames.demand_of(frame, now_ns)
            if demand is not None:
                self._take_pedals(demand)
        if self.pedal_frames.silent(now_ns):
            self.arbiter.end(PEDALS_SOURCE)
        return self.pedal_frames.observe(now_ns)

    def _take_pedals(self, one: PedalDemand) -> None:
        """Offer a demand of the pedals, at the time when its frame came.

        Frames are read right before the tick, so that `arm` may have been granted meanwhile.
        """
        if one.resumed:
            self.arbiter.end(PEDALS_SOURCE)
        ttl_ms = self.pedal_frames.ttl_ms(self.terms.period_ns)
        demand = Demand(PEDALS_SOURCE, one.sequence, ttl_ms, one.controllers, one.made_ns)
        at_ns = max(one.made_ns, self.arbiter.made_ns)
        granted = self._take(demand, at_ns, known=one.known).granted
        pressed = self._commander.pedals.zero_for_ns(at_ns) is None
        if granted and pressed and one.made_ns < self._modes.supervisor.since_ns:
            reason = "the pedals were not released before arming"
            self._modes.apply(Stimulus.DISARM, at_ns, reason)

    def end_demand(self, source: str, now_ns: int) -> RequestResult:
        """End the owner's demand, and the drive with it; refused for any other source."""
        self._modes.judge_lateness(now_ns)
        result = self._of_pedals(source) or self.arbiter.end(source)
        if result.granted:
            self._modes.apply(Stimulus.DEMAND_EXPIRED, now_ns, f"{source} ended its demand")
        return result

    def arm(self, now_ns: int) -> RequestResult:
        """Enter ACTIVE from STANDBY; refused where `against_arming` has a reason."""
        self._modes.judge_lateness(now_ns)
        if reason := self.against_arming(now_ns):
            return self.refuse("arm", reason)
        self._modes.apply(Stimulus.ARM, now_ns, "armed on request")
        return GRANTED

    def disarm(self, now_ns: int) -> RequestResult:
        """Leave ACTIVE for STANDBY; always granted."""
        self._modes.judge_lateness(now_ns)
        self._modes.apply(Stimulus.DISARM, now_ns, "disarmed on request")
        return GRANTED

    def emergency_stop(self) -> RequestResult:
        """Cut the power in the next tick; always granted."""
        self.emergency_stop_requested = True
        return GRANTED

    def terminate(self) -> None:
        """End: safe frames, then `Gateway.finished`."""
        self.terminating = True

    def reset(self, level: FaultClass, now_ns: int) -> RequestResult:
        """Leave FAULT for STARTING; refused where `against_resetting` has a reason."""
        if reason := self.against_resetting(level, now_ns):
            return self.refuse("reset", reason)
        self._modes.apply(Stimulus.RESET, now_ns, f"reset at {level.value} level")
        return GRANTED

    def refuse(self, request: str, reason: str) -> RequestResult:
        """Refuse a request, with an event."""
        fields = {"request": request, "sentence": reason}
        self._modes.emit(Event("request_refused", Severity.WARNING, fields))
        return refused(Refusal.NOT_ALLOWED_NOW, reason)

    def against_arming(self, now_ns: int) -> str:
        """First reason against entering ACTIVE now; empty where there is none."""
        return arming_refusal(self._inputs(now_ns))

    def against_resetting(self, level: FaultClass, now_ns: int) -> str:
        """First reason against leaving FAULT now at this level; empty where there is none."""
        return reset_refusal(self._inputs(now_ns), level)

    def _inputs(self, now_ns: int) -> RequestInputs:
        demanded = self.demanded(now_ns)
        return RequestInputs(
            supervisor=self._modes.supervisor,
            causes=self._modes.causes,
            emergency_stop=self.emergency_stop_requested,
            demanded=demanded,
            zero_for_ns=self._commander.pedals.zero_for_ns(now_ns),
            reverse_pending=demanded is not None and self._commander.reverse_pending(demanded),
            independent_directions=self.terms.independent_directions,
            listening=not self._listening.over,
            restarts=self.restarts,
            restart_state_failure=self.restart_state_failure,
            speed_pending=self._commander.speed_pending(),
        )

    def demanded(self, now_ns: int) -> ControllerDemands | None:
        """Demand of each controller; None without a fresh demand.

        The bench demand's throttle counts in ACTIVE only: it never changes, so it could
        otherwise never be armed with a throttle of 0.
        """
        demand = self.arbiter.current
        if demand is None or not self.arbiter.fresh(now_ns):
            return None
        if demand.source != BENCH_SOURCE or self._modes.supervisor.mode is Mode.ACTIVE:
            return demand.controllers
        return {
            name: dataclasses.replace(one, throttle_pct=0.0)
            for name, one in demand.controllers.items()
        }


def arming_refusal(inputs: RequestInputs) -> str:
    """First reason against entering ACTIVE; empty where there is none."""
    if inputs.restarts > _RESTARTS_MAX:
        remedy = "find out why, then restart the service"
        return f"the gateway was restarted {inputs.restarts} times in this drive; {remedy}"
    if inputs.listening:
        return LISTENING
    if inputs.supervisor.mode is not Mode.STANDBY:
        return f"arming needs standby, the mode is {inputs.supervisor.mode.value}"
    if inputs.restart_state_failure is not None:
        return f"the restart state cannot be kept: {inputs.restart_state_failure}"
    return _blocking_cause(inputs) or _against_demand(inputs)


def _against_demand(inputs: RequestInputs) -> str:
    if inputs.demanded is None:
        return "there is no fresh demand"
    if _throttle_demanded(inputs.demanded):
        return "the demanded throttle is not 0"
    if inputs.zero_for_ns is None or inputs.zero_for_ns < RELEASED_MS * NS_PER_MS:
        return f"the demanded throttle has not been 0 for {RELEASED_MS} ms"
    if not inputs.independent_directions and directions_differ(inputs.demanded):
        return "both controllers must have the same direction"
    if inputs.reverse_pending:
        return "a change of direction is pending"
    if inputs.speed_pending:
        return "the speed limit has not come down to its cap"
    return ""


def reset_refusal(inputs: RequestInputs, level: FaultClass) -> str:
    """First reason against leaving FAULT at this level; empty where there is none."""
    if inputs.listening:
        return LISTENING
    latch = inputs.supervisor.latch
    if latch is None or inputs.supervisor.mode is not Mode.FAULT:
        return "nothing is latched"
    if latch.fault_class is FaultClass.SERVICE and level is not FaultClass.SERVICE:
        return f"{latch.reason} needs a reset at service level"
    throttle = "the demanded throttle is not 0" if _throttle_demanded(inputs.demanded) else ""
    return _blocking_cause(inputs) or throttle


def reload_refusal(before: Settings, after: Settings, mode: Mode) -> str:
    """First reason against taking new settings; while ACTIVE limits only become stricter."""
    if names := [name for name in changed(before, after) if name in RESTART_ONLY]:
        return f"these need a restart: {', '.join(names)}"
    if mode is Mode.ACTIVE and (looser := loosened(before, after)):
        return f"while active, limits may only become stricter: {', '.join(looser)}"
    return ""


def _blocking_cause(inputs: RequestInputs) -> str:
    if inputs.emergency_stop:
        return "an emergency stop was requested"
    blocking = inputs.causes.having(BLOCKING)
    return f"{blocking[0].finding} stands or stood a moment ago" if blocking else ""


def _throttle_demanded(demanded: ControllerDemands | None) -> bool:
    return demanded is not None and any(one.throttle_pct > 0 for one in demanded.values())
