"""Mode of the gateway: how it begins, is held from tick to tick, and ends.

Findings come with a tick, requests between two ticks; both change the mode in the mode manager
alone, and every change is an event of the next tick's result.
"""

from collections.abc import Iterable, Iterator, Mapping

from vcu_gateway.core import rules
from vcu_gateway.core.causes import BLOCKING, Causes, Effect, Event, Finding
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Quality, Snapshot
from vcu_gateway.core.supervisor import Mode, Stimulus, Supervisor
from vcu_gateway.core.why import WAITING_FOR
from vcu_gateway.units import NS_PER_MS


class ListenBeforeTalk:
    """Listen before talk: silent for a while, and as long as another sender is there.

    Once over it is over until the next start.
    """

    def __init__(self, now_ns: int, listen_ms: int) -> None:
        self._quiet_until_ns = now_ns + listen_ms * NS_PER_MS
        self._listen_ns = listen_ms * NS_PER_MS
        self.over = False

    def again(self, now_ns: int) -> None:
        """Begin the whole time again: there was another sender, or no bus."""
        self._quiet_until_ns = now_ns + self._listen_ns

    def update(self, now_ns: int) -> bool:
        """True from the end of the listening on."""
        self.over = self.over or now_ns >= self._quiet_until_ns
        return self.over


class Qualification:
    """Enough good frames of every required message since one of them, or the link, was lost."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}
        self._missing: set[str] | None = None

    def observe(self, snapshot: Snapshot, required: tuple[str, ...]) -> bool:
        """Begin anew where a required message was lost; True while none is missing."""
        missing = set(snapshot.stale_messages()).intersection(required)
        if self._missing is not None and missing - self._missing:
            self.begin(snapshot, required)
        self._missing = missing
        return not missing

    def begin(self, snapshot: Snapshot, required: tuple[str, ...]) -> None:
        self._before = {message: _good_frames(snapshot, message) for message in required}

    def missing(self, snapshot: Snapshot, settings: Settings) -> Iterator[str]:
        """Conditions still waited for, as sentences."""
        for message in settings.required_messages:
            good = _good_frames(snapshot, message) - self._before.get(message, 0)
            if snapshot.stale(message):
                yield f"{WAITING_FOR}{message}"
            elif good < settings.qualify_frames:
                yield f"{WAITING_FOR}{message}: {good} of {settings.qualify_frames} good frames"


def _good_frames(snapshot: Snapshot, message: str) -> int:
    latest = snapshot.latest(message)
    return 0 if latest is None else latest.frame_count - latest.marked_count


def echoed_directions(snapshot: Snapshot, controllers: Iterable[str]) -> Mapping[str, bool]:
    """Reverse or not, of each of these controllers that echoes its last command."""
    readings = {name: snapshot.reading(f"{name}_Status1", "MotorReverse") for name in controllers}
    return {name: bool(one.value) for name, one in readings.items() if one.quality is Quality.GOOD}


_TICKS = 3
_TICKS_AT_MOST = 10


class Shutdown:
    """Orderly end: a few ticks of safe frames in STOPPING."""

    def __init__(self) -> None:
        self._ticks = 0
        self._unsent_ticks = 0
        self._unsent_in_tick = False

    def note_tick(self, stopping: bool) -> None:
        self._unsent_ticks += self._unsent_in_tick and self._ticks > 0
        self._unsent_in_tick = False
        self._ticks += stopping

    def note_unsent(self) -> None:
        self._unsent_in_tick = True

    def over(self, talking: bool) -> bool:
        """True where the safe frames were sent, or cannot be; valid after each tick's sending."""
        return self._ticks > 0 and (self._sent or self.gave_up or not talking)

    @property
    def gave_up(self) -> bool:
        """True where the bus did not take the safe frames in time; valid as `over` is."""
        return self._ticks >= _TICKS_AT_MOST and not self._sent

    @property
    def _sent(self) -> bool:
        return self._ticks - self._unsent_ticks - self._unsent_in_tick >= _TICKS


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
