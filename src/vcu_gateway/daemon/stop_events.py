"""Stop events: each change of what is known of a latched CUT, once."""

from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.stop import GAP_NS, Stop, StopStage
from vcu_gateway.daemon.event_log import EventLog


class StopEvents:
    """Emits `stop_stage` where the stage changes, or lasts for longer than it should."""

    def __init__(self, event_log: EventLog) -> None:
        self._event_log = event_log
        self._told: tuple[int, StopStage, Severity] | None = None

    def after_tick(self, stop: Stop | None, now_ns: int) -> None:
        """Once a tick, with the stop as it was known then; None where no CUT was latched."""
        if stop is None:
            self._told = None
            return
        severity = _severity(stop, now_ns)
        if self._told == (told := (stop.latched_ns, stop.stage, severity)):
            return
        self._told = told
        fields = {"stage": stop.stage.value, "sentence": stop.sentence()}
        self._event_log.emit(Event("stop_stage", severity, fields))


def _severity(stop: Stop, now_ns: int) -> Severity:
    """WARNING where frames should be on the bus, or controllers should have answered, by now."""
    if stop.stage is StopStage.NOT_OBEYED:
        return Severity.CRITICAL
    waits_long = now_ns - stop.latched_ns > GAP_NS
    if stop.overdue or (waits_long and stop.stage in (StopStage.LATCHED, StopStage.SENT)):
        return Severity.WARNING
    return Severity.INFO
