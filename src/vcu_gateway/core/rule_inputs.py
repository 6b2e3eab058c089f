"""All that the rules may look at: the snapshot, and facts that no message carries."""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core.link import LinkStatus
from vcu_gateway.core.plausibility import NO_DEVIATION, History, Observed
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot

NOTHING_SENT: History = {}


class RuleInputs(NamedTuple):
    """One instant.

    Attributes:
        late_after_ns: by message name.
        history: the last throttles and directions sent to each controller, oldest first.
        observed: what frames say that only holds against the ones before them.
        passive_ns: error-passive in all during the last 5 s.
        tick_late_ns: how long after its period this tick comes.
        unconfirmed_ticks: ticks in a row whose frames did not come back from the bus.
        foreign_sender: identifier of a command that another node sent since the last tick.
        emergency_stop: requested since the last tick.
        blocked_by_gate: what the gate blocked in the last tick.
    """

    snapshot: Snapshot
    settings: Settings
    late_after_ns: Mapping[str, int]
    link: LinkStatus
    history: History = NOTHING_SENT
    observed: Observed = NO_DEVIATION
    passive_ns: int = 0
    tick_late_ns: int = 0
    period_ns: int = 50_000_000
    unconfirmed_ticks: int = 0
    foreign_sender: int | None = None
    emergency_stop: bool = False
    blocked_by_gate: str | None = None
