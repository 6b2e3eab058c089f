"""Supervisor: modes, their transitions as a total table, and the latched fault.

Only ACTIVE can carry torque; it is reached by an explicit request from STANDBY alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from vcu_gateway.core.causes import Event, Severity


class Mode(Enum):
    """Operating mode of the gateway; docs/safety.md, Modes."""

    STARTING = "starting"
    STANDBY = "standby"
    ACTIVE = "active"
    FAULT = "fault"
    STOPPING = "stopping"


class Stimulus(Enum):
    """Stimulus of a mode change, the most urgent first."""

    TERMINATE = "terminate"
    CUT = "cut"
    LATCHING_STOP = "latching stop"
    STOP = "stop"
    DEMAND_EXPIRED = "demand expired"
    REQUIRED_LOST = "required message lost"
    QUALIFIED = "qualified"
    ARM = "arm"
    DISARM = "disarm"
    RESET = "reset"


class FaultClass(Enum):
    """Class of a latched fault: the level that may reset it."""

    DRIVER = "driver"
    SERVICE = "service"


_STARTING, _STANDBY, _ACTIVE = Mode.STARTING, Mode.STANDBY, Mode.ACTIVE
_FAULT, _STOPPING = Mode.FAULT, Mode.STOPPING

TRANSITIONS: Mapping[Stimulus, tuple[Mode, Mode, Mode, Mode, Mode]] = {
    #                          STARTING   STANDBY    ACTIVE     FAULT      STOPPING
    Stimulus.TERMINATE:       (_STOPPING, _STOPPING, _STOPPING, _STOPPING, _STOPPING),
    Stimulus.CUT:             (_FAULT,    _FAULT,    _FAULT,    _FAULT,    _STOPPING),
    Stimulus.LATCHING_STOP:   (_FAULT,    _FAULT,    _FAULT,    _FAULT,    _STOPPING),
    Stimulus.STOP:            (_STARTING, _STANDBY,  _FAULT,    _FAULT,    _STOPPING),
    Stimulus.DEMAND_EXPIRED:  (_STARTING, _STANDBY,  _STANDBY,  _FAULT,    _STOPPING),
    Stimulus.REQUIRED_LOST:   (_STARTING, _STARTING, _FAULT,    _FAULT,    _STOPPING),
    Stimulus.QUALIFIED:       (_STANDBY,  _STANDBY,  _ACTIVE,   _FAULT,    _STOPPING),
    Stimulus.ARM:             (_STARTING, _ACTIVE,   _ACTIVE,   _FAULT,    _STOPPING),
    Stimulus.DISARM:          (_STARTING, _STANDBY,  _STANDBY,  _FAULT,    _STOPPING),
    Stimulus.RESET:           (_STARTING, _STANDBY,  _ACTIVE,   _STARTING, _STOPPING),
}  # fmt: skip

_COLUMNS = (_STARTING, _STANDBY, _ACTIVE, _FAULT, _STOPPING)


def following(mode: Mode, stimulus: Stimulus) -> Mode:
    """The mode after a stimulus; total over both."""
    return TRANSITIONS[stimulus][_COLUMNS.index(mode)]


@dataclass(frozen=True, slots=True)
class LatchedFault:
    """Latched fault: the level that may reset it, and its reason as a person reads it."""

    fault_class: FaultClass
    reason: str
    since_ns: int


class Supervisor:
    """The mode and the latch; both change here only.

    Attributes:
        latch: the fault that is latched; None outside FAULT, unless STOPPING out of it or with
            a CUT meanwhile: the next start is to know of that.
    """

    def __init__(self, now_ns: int) -> None:
        self.mode = Mode.STARTING
        self.since_ns = now_ns
        self.latch: LatchedFault | None = None

    def apply(self, stimulus: Stimulus, now_ns: int, reason: str = "") -> list[Event]:
        """Go where the table says; an event where that changes the mode or the latch."""
        before, after = self.mode, following(self.mode, stimulus)
        events = []
        if after is Mode.FAULT or stimulus is Stimulus.CUT:
            events += self._latch(stimulus, now_ns, reason)
        elif after is not Mode.STOPPING:
            self.latch = None
        if after is not before:
            self.mode, self.since_ns = after, now_ns
            fields = {"before": before.value, "after": after.value, "reason": reason}
            severity = Severity.ERROR if after is Mode.FAULT else Severity.INFO
            events.append(Event("mode_changed", severity, fields))
        return events

    def _latch(self, stimulus: Stimulus, now_ns: int, reason: str) -> list[Event]:
        """Latch, or raise the class of what is latched; the first reason stays otherwise."""
        latching = (Stimulus.CUT, Stimulus.LATCHING_STOP, Stimulus.STOP, Stimulus.REQUIRED_LOST)
        if stimulus not in latching:
            return []
        wanted = FaultClass.SERVICE if stimulus is Stimulus.CUT else FaultClass.DRIVER
        raised = wanted is FaultClass.SERVICE
        if self.latch is not None and (self.latch.fault_class is wanted or not raised):
            return []
        self.latch = LatchedFault(wanted, reason, now_ns)
        fields = {"fault_class": wanted.value, "reason": reason}
        return [Event("fault_latched", Severity.CRITICAL, fields)]

    @property
    def power_is_cut(self) -> bool:
        """True while a fault of service class is latched: POWER_CUT instead of ZERO_TORQUE."""
        return self.latch is not None and self.latch.fault_class is FaultClass.SERVICE
