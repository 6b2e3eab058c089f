"""Mode manager: the supervisor's mode, the causes that move it, and the events of both.

Findings come with a tick, requests between two ticks; both change the mode here alone, and every
change is an event of the next tick's result.
"""

from collections.abc import Iterable

from vcu_gateway.core import rules
from vcu_gateway.core.causes import BLOCKING, Causes, Effect, Finding
from vcu_gateway.core.events import Event
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode, Stimulus, Supervisor


class ModeManager:
    """Mode and causes from one tick to the next, with the events not handed out yet.

    Attributes:
        supervisor: mode and latch.
        causes: every cause that counts.
        auto_arm_pending: ACTIVE may still be entered once without a request, on a test bench.
    """

    def __init__(self, settings: Settings, now_ns: int) -> None:
        self.supervisor = Supervisor(now_ns)
        self.causes = Causes()
        self.auto_arm_pending = settings.auto_arm and settings.bench_demand is not None
        self._period_ns = settings.period_ns
        self._last_tick_ns: int | None = None
        self._was_active = False
        self._events: list[Event] = []

    def emit(self, event: Event) -> None:
        """Hand an event out with the next tick's result."""
        self._events.append(event)

    def apply(self, stimulus: Stimulus, now_ns: int, reason: str) -> None:
        """Give the supervisor a stimulus; a disarm or a fault ends the bench's own arming."""
        self._events += self.supervisor.apply(stimulus, now_ns, reason)
        if stimulus is Stimulus.DISARM or self.supervisor.mode is Mode.FAULT:
            self.auto_arm_pending = False  # a reset never leads to ACTIVE by itself

    def update(self, findings: Iterable[Finding], hold_ns: int, now_ns: int) -> None:
        """Take in what the rules found in this tick; `apply_causes` follows."""
        self._events += self.causes.update(findings, hold_ns, now_ns)

    def apply_causes(self, now_ns: int) -> None:
        """Apply the stimulus of every cause that stops or cuts."""
        for held in self.causes.having(BLOCKING):
            self.apply(_stimulus_of(held.finding), now_ns, str(held.finding))

    def latch(self, finding: Finding, now_ns: int, reason: str) -> None:
        """Enter FAULT at once for a finding that no rule of the tick has seen."""
        self._events += self.causes.note(finding, now_ns)
        self.apply(Stimulus.LATCHING_STOP, now_ns, reason)

    def judge_lateness(self, now_ns: int) -> int:
        """Latch a tick that is too late in ACTIVE, before anything else of it is applied.

        It was ACTIVE that had to be ticked where only a request since the tick before ended it.
        How late it is: negative before its period is over, 0 for the first.
        """
        last_ns = self._last_tick_ns
        late_ns = 0 if last_ns is None else now_ns - last_ns - self._period_ns
        if self._was_active or self.supervisor.mode is Mode.ACTIVE:
            for finding in rules.late(late_ns, self._period_ns):
                self.latch(finding, now_ns, str(finding))
        return late_ns

    def end_tick(self, now_ns: int) -> tuple[Event, ...]:
        """All events since the last tick; the time to the next one counts from `now_ns`."""
        self._last_tick_ns = now_ns
        self._was_active = self.supervisor.mode is Mode.ACTIVE
        events = tuple(self._events)
        self._events.clear()
        return events

    @property
    def power_is_cut(self) -> bool:
        """True where a safe frame has to be POWER_CUT instead of ZERO_TORQUE."""
        return self.supervisor.power_is_cut or Effect.CUT in self.causes.effects()


def _stimulus_of(finding: Finding) -> Stimulus:
    if finding.effect is Effect.CUT:
        return Stimulus.CUT
    return Stimulus.LATCHING_STOP if finding.latches else Stimulus.STOP
