"""Stop: what is known of a latched CUT at each controller; docs/safety.md says by what it is known.

`StopWatch` is told which frames the kernel took and which came back, and holds them and the
controllers' own status against the latch. Only frames with the bit of POWER_CUT count.
"""

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import NamedTuple

from vcu_gateway.core.demand import CONTROLLERS, RELEASED_PCT
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.state import FUTURE_TOLERANCE_NS, LatestFrame, Snapshot
from vcu_gateway.core.supervisor import LatchedFault
from vcu_gateway.units import NS_PER_MS

GAP_NS = 150 * NS_PER_MS
"""A frame that is older than this says nothing of now."""

_JUDGED_FROM_NS = 100 * NS_PER_MS
_KNOWN_FOR_NS = 1600 * NS_PER_MS
_CUT_RAW = 1


class StopStage(Enum):
    """How far a stop has come, as far as is known."""

    LATCHED = "latched"
    SENT = "sent"
    ON_BUS = "on the bus"
    CUT = "cut"
    NOT_OBEYED = "not obeyed"


class ControllerStop(NamedTuple):
    """What is known of a stop at one controller; None where it is unknown or not so.

    Attributes:
        sent_ns: since when frames with POWER_CUT are taken by the kernel without a gap.
        echoed_ns: since when they come back from the bus.
        obeyed: whether the controller's own status says that it has cut.
        judged_ns: arrival of the status that was judged.
        power_cut, throttle_pct: PowerCut, by its code's name, and Throttle in this status.
    """

    sent_ns: int | None = None
    echoed_ns: int | None = None
    obeyed: bool | None = None
    judged_ns: int | None = None
    power_cut: str | None = None
    throttle_pct: float | None = None

    @property
    def report(self) -> str:
        """What the controller says of itself, where it was judged."""
        return f"reports PowerCut {self.power_cut}, throttle {self.throttle_pct:.1f} %"


class Stop(NamedTuple):
    """What is known of the latched CUT.

    Attributes:
        overdue: controllers that should have said by now whether they obey.
    """

    latched_ns: int
    reason: str
    stage: StopStage
    controllers: Mapping[str, ControllerStop]
    overdue: tuple[str, ...]

    def sentence(self) -> str:
        """The stop in one line, which claims no more than is known."""
        known = self.controllers.items()
        if self.stage is StopStage.NOT_OBEYED:
            reports = [f"{name} {one.report}" for name, one in known if one.obeyed is False]
            return f"NOT OBEYED: {', and '.join(reports)}; use the contactor"
        if self.stage is StopStage.LATCHED:
            unsent = " and ".join(name for name, one in known if one.sent_ns is None)
            return f"Stop latched; not sent to {unsent}"
        if self.stage is StopStage.SENT:
            unseen = " and ".join(name for name, one in known if one.echoed_ns is None)
            return f"Stop sent; not seen on the bus for {unseen}"
        if self.overdue:
            verb = "does" if len(self.overdue) == 1 else "do"
            return f"Stop sent; {' and '.join(self.overdue)} {verb} not confirm"
        if self.stage is StopStage.ON_BUS:
            unknown = " and ".join(name for name, one in known if one.obeyed is None)
            return f"Stop on the bus; waiting for {unknown} to confirm"
        return f"Power is cut: {' and '.join(self.controllers)} confirm"

    def missing(self, controller: str) -> str:
        """What is not known to be so of this controller; empty where nothing is missing."""
        one = self.controllers[controller]
        if one.obeyed is False:
            return one.report
        if one.sent_ns is None:
            return "not sent"
        if one.echoed_ns is None:
            return "not seen on the bus"
        if one.obeyed is None:
            return "does not confirm" if controller in self.overdue else "has not confirmed yet"
        return ""


class _Run:
    """Frames with POWER_CUT to one controller: since when they come without a gap.

    Attributes:
        first_ns: the first of this stop, whatever gaps followed; None before it.
    """

    def __init__(self) -> None:
        self.first_ns: int | None = None
        self._since_ns: int | None = None
        self._last_ns: int | None = None

    def note(self, at_ns: int) -> None:
        """A frame at this time; it may be one that was noted before."""
        if self.first_ns is None:
            self.first_ns = at_ns
        if self.holds_since_ns(at_ns) is None:
            self._since_ns = at_ns
        self._last_ns = at_ns

    def holds_since_ns(self, now_ns: int) -> int | None:
        """Since when they have come; None where they do not."""
        if self._last_ns is None or now_ns - self._last_ns > GAP_NS:
            return None
        return self._since_ns


class StopWatch:
    """Keeps what is known of one latched CUT; a CUT that is latched anew begins with nothing.

    `power_cut_bits` has the place of the bit POWER_CUT in each controller's command: byte, mask.
    """

    def __init__(self, power_cut_bits: Mapping[str, tuple[int, int]]) -> None:
        self._bits = power_cut_bits
        self._begin(None)

    def _begin(self, latch: LatchedFault | None) -> None:
        self._latch = latch
        self._sent = {name: _Run() for name in CONTROLLERS}
        self._echoed = {name: _Run() for name in CONTROLLERS}

    def follow(self, latch: LatchedFault | None, echoes: Mapping[str, Frame]) -> None:
        """Take in the latched CUT of this tick and the last command of each that came back."""
        if latch is not self._latch:
            self._begin(latch)
        if latch is None:
            return
        for name, echo in echoes.items():
            if echo.arrival_ns >= latch.since_ns and self._is_cut(name, echo.data):
                self._echoed[name].note(echo.arrival_ns)

    def note_sent(self, controller: str, data: bytes, now_ns: int) -> None:
        if self._is_cut(controller, data):
            self._sent[controller].note(now_ns)

    def _is_cut(self, controller: str, data: bytes | bytearray) -> bool:
        byte, mask = self._bits[controller]
        return data[byte] & mask != 0

    def judged(self, snapshot: Snapshot, now_ns: int) -> Stop | None:
        """The stop as it is known now; None where no CUT was latched in the last tick."""
        if self._latch is None:
            return None
        controllers = {name: self._known(name, snapshot, now_ns) for name in CONTROLLERS}
        overdue = tuple(
            name
            for name, one in controllers.items()
            if one.obeyed is None and self._is_overdue(name, now_ns)
        )
        since_ns, reason = self._latch.since_ns, self._latch.reason
        return Stop(since_ns, reason, _stage(controllers.values()), controllers, overdue)

    def _is_overdue(self, controller: str, now_ns: int) -> bool:
        first_ns = self._echoed[controller].first_ns
        return first_ns is not None and now_ns - first_ns >= _KNOWN_FOR_NS

    def _known(self, controller: str, snapshot: Snapshot, now_ns: int) -> ControllerStop:
        known = ControllerStop(
            self._sent[controller].holds_since_ns(now_ns),
            self._echoed[controller].holds_since_ns(now_ns),
        )
        message, first_ns = f"{controller}_Status1", self._echoed[controller].first_ns
        status = snapshot.latest(message)
        if first_ns is None or status is None or not _counts(status, first_ns, now_ns):
            return known
        raw = status.decoded.raws[snapshot.index(message, "PowerCut")]
        throttle_pct = status.decoded.values[snapshot.index(message, "Throttle")]
        return known._replace(
            obeyed=raw == _CUT_RAW and throttle_pct < RELEASED_PCT,
            judged_ns=status.arrival_ns,
            power_cut=snapshot.code_name(message, "PowerCut", raw) or f"code {raw}",
            throttle_pct=throttle_pct,
        )


def _counts(status: LatestFrame, first_echo_ns: int, now_ns: int) -> bool:
    """True for a status that is late enough after the first echo, and not too old."""
    if status.arrival_ns - first_echo_ns < _JUDGED_FROM_NS:
        return False
    return -FUTURE_TOLERANCE_NS <= now_ns - status.arrival_ns <= _KNOWN_FOR_NS


def _stage(controllers: Iterable[ControllerStop]) -> StopStage:
    known = list(controllers)
    if any(one.obeyed is False for one in known):
        return StopStage.NOT_OBEYED
    if any(one.sent_ns is None for one in known):
        return StopStage.LATCHED
    if any(one.echoed_ns is None for one in known):
        return StopStage.SENT
    return StopStage.CUT if all(one.obeyed for one in known) else StopStage.ON_BUS
