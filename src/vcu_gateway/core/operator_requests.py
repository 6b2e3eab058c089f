"""What people and programs may ask for: demand, arming, resetting, new settings.

Before a request may change the mode the lateness of the tick is judged: a gateway that was away
in ACTIVE has latched its fault before anybody ends the drive in another way.
"""

import dataclasses
from collections.abc import Callable

from vcu_gateway.core import permission
from vcu_gateway.core.causes import Causes
from vcu_gateway.core.commands import Commander
from vcu_gateway.core.demand import (
    BENCH_SOURCE,
    GRANTED,
    Demand,
    DemandArbiter,
    DemandTerms,
    Refusal,
    RequestResult,
    refused,
)
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.core.lifecycle import ListenBeforeTalk
from vcu_gateway.core.permission import Asked, Pedal
from vcu_gateway.core.settings import RESTART_ONLY, Settings, changed, loosened
from vcu_gateway.core.supervisor import FaultClass, Mode, Stimulus, Supervisor
from vcu_gateway.core.transmit import Transmitter

# With this many unexpected starts in one drive nobody knows what the next minute brings.
_RESTARTS_AT_MOST = 2

LISTENING = "listening for another sender of our frames"

Apply = Callable[[Stimulus, int, str], None]
"""Gives the supervisor a stimulus, at a time, with its reason."""


@dataclasses.dataclass(frozen=True, slots=True)
class Parts:
    """What a request is judged by and may change."""

    supervisor: Supervisor
    causes: Causes
    commander: Commander
    listening: ListenBeforeTalk
    output: Transmitter
    apply: Apply
    judge_lateness: Callable[[int], None]
    tell: Callable[[Event], None]


class OperatorRequests:
    """Grants or refuses, on the ticking thread, with a sentence.

    Attributes:
        settings: what is in effect.
        desk: whose demand counts.
        emergency_stop_asked: since the last tick; terminating: asked to end.
        restarts: unexpected starts of this gateway in this drive.
    """

    def __init__(self, settings: Settings, parts: Parts) -> None:
        self.settings = settings
        self.desk = DemandArbiter(settings.bench_demand)
        self.emergency_stop_asked = False
        self.terminating = False
        self.restarts = 0
        self._parts = parts

    def offer(self, demand: Demand, now_ns: int) -> RequestResult:
        """Take a demand of a source, or say why not."""
        self._parts.judge_lateness(now_ns)
        before = self.desk.current
        if not self.desk.fresh(now_ns):
            # It expired between two ticks: a new one does not continue the drive.
            self._parts.apply(Stimulus.DEMAND_EXPIRED, now_ns, "the demand expired")
            self._parts.commander.pedals.interrupted()
        answer = self.desk.offer(demand, _terms(self.settings), now_ns)
        if answer.granted:
            self._judge(demand, before, now_ns)
        return answer

    def _judge(self, demand: Demand, before: Demand | None, now_ns: int) -> None:
        """A granted demand counts from now on, also where another follows before the tick."""
        pedals = self._parts.commander.pedals
        if before is None or before.source != demand.source:
            self._parts.tell(Event("demand_owner", Severity.INFO, {"source": demand.source}))
            if self._parts.supervisor.mode is Mode.ACTIVE:
                pedals.taken_over()
        made_ns = now_ns if demand.made_ns is None else demand.made_ns
        pedals.judge(demand.controllers, made_ns, now_ns)

    def end_demand(self, source: str, now_ns: int) -> RequestResult:
        """The owner's demand counts no more, and the drive ends; refused for any other source."""
        self._parts.judge_lateness(now_ns)
        answer = self.desk.end(source)
        if answer.granted:
            self._parts.apply(Stimulus.DEMAND_EXPIRED, now_ns, f"{source} ended its demand")
        return answer

    def arm(self, now_ns: int) -> RequestResult:
        """Ask for ACTIVE; granted in STANDBY where nothing speaks against it."""
        self._parts.judge_lateness(now_ns)
        if why_not := self.against_arming(now_ns):
            return self._refuse("arm", why_not)
        self._parts.apply(Stimulus.ARM, now_ns, "armed on request")
        return GRANTED

    def disarm(self, now_ns: int) -> RequestResult:
        """Leave ACTIVE for STANDBY; always granted."""
        self._parts.judge_lateness(now_ns)
        self._parts.apply(Stimulus.DISARM, now_ns, "disarmed on request")
        return GRANTED

    def emergency_stop(self) -> RequestResult:
        """Cut the power in the next tick; always granted."""
        self.emergency_stop_asked = True
        return GRANTED

    def terminate(self) -> None:
        """End: safe frames, then `Gateway.finished`."""
        self.terminating = True

    def reset(self, level: FaultClass, now_ns: int) -> RequestResult:
        """Leave FAULT for STANDBY; refused while anything speaks against it."""
        if why_not := self.against_resetting(level, now_ns):
            return self._refuse("reset", why_not)
        self._parts.apply(Stimulus.RESET, now_ns, f"reset at {level.value} level")
        return GRANTED

    def reload(self, settings: Settings) -> RequestResult:
        """Take new settings whole or not at all; while ACTIVE only stricter limits."""
        if names := [name for name in changed(self.settings, settings) if name in RESTART_ONLY]:
            return self._refuse("reload", f"these need a restart: {', '.join(names)}")
        active = self._parts.supervisor.mode is Mode.ACTIVE
        if active and (looser := loosened(self.settings, settings)):
            sentence = f"while active, limits may only become stricter: {', '.join(looser)}"
            return self._refuse("reload", sentence)
        self.settings = settings
        self._parts.output.reload(settings)
        return GRANTED

    def _refuse(self, request: str, sentence: str) -> RequestResult:
        fields = {"request": request, "sentence": sentence}
        self._parts.tell(Event("request_refused", Severity.WARNING, fields))
        return refused(Refusal.NOT_ALLOWED_NOW, sentence)

    def against_arming(self, now_ns: int) -> str:
        """Why ACTIVE cannot be entered now; empty where nothing speaks against it."""
        parts = self._parts
        if self.restarts > _RESTARTS_AT_MOST:
            return _restarted_too_often(self.restarts)
        if not parts.listening.over:
            return LISTENING
        asked = self.asked(now_ns)
        pedal = Pedal(
            asked=asked,
            zero_for_ns=parts.commander.pedals.zero_for_ns(now_ns),
            reverse_pending=asked is not None and parts.commander.reverse_pending(asked),
            independent_directions=self.settings.independent_directions,
        )
        return permission.against_arming(parts.supervisor, parts.causes, pedal)

    def against_resetting(self, level: FaultClass, now_ns: int) -> str:
        """Why FAULT cannot be left now; empty where nothing speaks against it."""
        parts = self._parts
        if not parts.listening.over:
            return LISTENING
        asked = self.asked(now_ns)
        return permission.against_resetting(parts.supervisor, parts.causes, asked, level)

    def asked(self, now_ns: int) -> Asked:
        """What is asked of each controller; None without a fresh demand.

        The bench demand's throttle counts in ACTIVE only: it never changes, so it could
        otherwise never be armed with a throttle of 0.
        """
        demand = self.desk.current
        if demand is None or not self.desk.fresh(now_ns):
            return None
        if demand.source != BENCH_SOURCE or self._parts.supervisor.mode is Mode.ACTIVE:
            return demand.controllers
        return {
            name: dataclasses.replace(asked, throttle_pct=0.0)
            for name, asked in demand.controllers.items()
        }


def _terms(settings: Settings) -> DemandTerms:
    return DemandTerms(
        ttl_max_ms=settings.ttl_max_ms,
        priorities=settings.priorities,
        independent_directions=settings.independent_directions,
        second_track_required=settings.second_track_required,
    )


def _restarted_too_often(times: int) -> str:
    return (
        f"the gateway was restarted {times} times in this drive; find out why, then restart"
        " the service"
    )
