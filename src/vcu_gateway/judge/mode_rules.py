"""Mode rules: which mode a tick may tell, from the mode before, granted requests and causes."""

from typing import NamedTuple

from vcu_gateway.judge.result import Findings

_AFTER: dict[str, set[str]] = {
    "starting": {"starting", "standby", "fault", "stopping"},
    "standby": {"standby", "starting", "active", "fault", "stopping"},
    "active": {"active", "standby", "starting", "fault", "stopping"},
    "fault": {"fault", "stopping"},
    "stopping": {"stopping"},
}


class TickCauses(NamedTuple):
    """What a tick sees that moves the mode.

    Attributes:
        stop, cut: a cause of this effect that stands; empty where there is none.
        foreign: another sender of our commands.
        late: more than four periods after the tick before.
    """

    stop: str
    cut: str
    foreign: bool
    late: bool
    demand_fresh: bool


class ModeRules:
    """The mode from tick to tick, and the latch.

    Attributes:
        mode: as the last tick told it; None before the first.
        may_be_active: ACTIVE has not ended since the last tick.
        cut_latched: POWER_CUT until a reset at service level.
    """

    def __init__(self, findings: Findings) -> None:
        self.mode: str | None = None
        self.may_be_active = False
        self.cut_latched = False
        self._findings = findings
        self._was_reset = self._bench_arms = False

    def bench(self) -> None:
        self._bench_arms = True

    def armed(self, tick: int, now_ns: int, against: str) -> None:
        """`arm` was granted; `against`: what the judge knows against it, else empty."""
        left = self.mode == "active" and not self.may_be_active  # since the last tick: standby
        if against or not (left or self.mode in (None, "standby")):
            why = against or f"in {self.mode}"
            self._findings.broken("arming", tick, now_ns, f"granted although {why}")
        self.may_be_active = True

    def left_active(self) -> None:
        self.may_be_active = False

    def reset(self, tick: int, now_ns: int, against: str, *, service: bool) -> None:
        """`reset` was granted; `against` as of `armed`."""
        if self.cut_latched and not service:
            self._findings.broken("reset", tick, now_ns, "a CUT was reset below service level")
        if against or self.mode not in (None, "fault"):
            why = against or f"in {self.mode}"
            self._findings.broken("reset", tick, now_ns, f"granted although {why}")
        self._was_reset, self.cut_latched = True, False

    def tick(self, number: int, now_ns: int, mode: str, causes: TickCauses) -> None:
        for rule, sentence in self._broken(mode, causes):
            self._findings.broken(rule, number, now_ns, sentence)
        if causes.cut and mode in ("fault", "stopping"):
            self.cut_latched = True
        self.mode = mode
        self.may_be_active = mode == "active"
        self._was_reset = False

    def _broken(self, mode: str, causes: TickCauses) -> list[tuple[str, str]]:
        before, found = self.mode, []
        if before is not None and mode not in self._allowed_after(before):
            found.append(("I6 modes", f"from {before} to {mode}"))
        if mode == "active":
            found += self._against_active(before, causes)
        if mode not in ("fault", "stopping"):
            found += self._against_no_fault(mode, before, causes)
        return found

    def _allowed_after(self, before: str) -> set[str]:
        allowed = _AFTER[before]
        if before == "fault" and self._was_reset:
            return allowed | {"starting", "standby"}
        return allowed

    def _against_active(self, before: str | None, causes: TickCauses) -> list[tuple[str, str]]:
        found = []
        entered = before is not None and not self.may_be_active and not self._bench_arms
        if entered:
            found.append(("I2 ACTIVE by arm alone", f"from {before} without an arm"))
        if not causes.demand_fresh:
            found.append(("an expired demand ends ACTIVE", "there is no fresh demand"))
        if causes.stop or causes.cut:
            found.append(("a STOP or CUT ends ACTIVE", causes.cut or causes.stop))
        return found

    def _against_no_fault(
        self, mode: str, before: str | None, causes: TickCauses
    ) -> list[tuple[str, str]]:
        if causes.cut:
            return [("a CUT latches FAULT", f"{causes.cut}, and the mode is {mode}")]
        if causes.foreign:
            return [("another sender latches FAULT", f"the mode is {mode}")]
        # A request in time that ended the drive does not excuse the late tick of it.
        if causes.late and (before == "active" or self.may_be_active):
            return [("a late tick latches FAULT", f"the mode is {mode}")]
        if causes.stop and self.may_be_active:
            return [("a STOP in ACTIVE latches FAULT", f"{causes.stop}, and the mode is {mode}")]
        return []
