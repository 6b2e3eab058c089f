"""Inputs of the rules: the snapshot of a tick, and facts that no message carries."""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core.coded_signals import CodedSignals
from vcu_gateway.core.link import LinkStatus
from vcu_gateway.core.plausibility import NO_DEVIATION, History, Observed, Plausibility
from vcu_gateway.core.receive import Receiver
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.snapshot import Snapshot
from vcu_gateway.core.transmit import SentHistory

NOTHING_SENT: History = {}


class RuleInputs(NamedTuple):
    """Inputs of every rule at one tick.

    Attributes:
        late_after_ns: by message name.
        coded: what the codes of battery and controllers find.
        history: the last throttles and directions sent to each controller, oldest first.
        observed: deviations from the frames before and from sent commands.
        passive_ns: error-passive in all during the last 5 s.
        tick_late_ns: how long after its period this tick comes.
        unconfirmed_ticks: ticks in a row whose frames did not come back from the bus.
        foreign_sender: identifier of a command that another node sent since the last tick.
        emergency_stop: requested since the last tick.
        blocked_by_gate: what the gate blocked in the last tick.
        restart_state_failure: why the restart state could not be kept in ACTIVE.
    """

    snapshot: Snapshot
    settings: Settings
    late_after_ns: Mapping[str, int]
    link: LinkStatus
    coded: CodedSignals
    history: History = NOTHING_SENT
    observed: Observed = NO_DEVIATION
    passive_ns: int = 0
    tick_late_ns: int = 0
    period_ns: int = 50_000_000
    unconfirmed_ticks: int = 0
    foreign_sender: int | None = None
    emergency_stop: bool = False
    blocked_by_gate: str | None = None
    restart_state_failure: str | None = None


class InputCollector:
    """Collects the inputs of each tick, and remembers what the next ones are held against.

    Attributes:
        blocked_by_gate: rule that the last tick's frames broke; None where they broke none.
    """

    def __init__(
        self, receiver: Receiver, history: SentHistory, late_after_ns: Mapping[str, int]
    ) -> None:
        self.blocked_by_gate: str | None = None
        self._receiver = receiver
        self._history = history
        self._late_after_ns = late_after_ns
        self._coded = CodedSignals()
        self._plausibility = Plausibility()
        self._foreign_before = 0

    def collect(
        self,
        snapshot: Snapshot,
        settings: Settings,
        tick_late_ns: int,
        emergency_stop: bool,
        restart_state_failure: str | None,
    ) -> RuleInputs:
        """The inputs of a tick at the time of this snapshot; once a tick."""
        receiver, monitor, sent = self._receiver, self._receiver.monitor, self._history
        monitor.begin_tick()
        blocked, self.blocked_by_gate = self.blocked_by_gate, None
        foreign, before = receiver.foreign_count, self._foreign_before
        self._foreign_before = foreign
        return RuleInputs(
            snapshot=snapshot,
            settings=settings,
            late_after_ns=self._late_after_ns,
            link=monitor.link,
            coded=self._coded,
            history=sent.frames,
            observed=self._plausibility.observe(snapshot, sent.frames, settings),
            passive_ns=monitor.recent_passive_ns(snapshot.now_ns),
            tick_late_ns=tick_late_ns,
            period_ns=settings.period_ns,
            unconfirmed_ticks=sent.note_confirmed(receiver.confirmed),
            foreign_sender=receiver.foreign_id if foreign > before else None,
            emergency_stop=emergency_stop,
            blocked_by_gate=blocked,
            restart_state_failure=restart_state_failure,
        )
