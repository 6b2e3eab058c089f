"""Tick loop: every 50 ms read, decide, send; signals and the orderly end."""

import signal
import time
from collections.abc import Callable
from typing import NamedTuple

from vcu_gateway.bus.connection import BusConnection
from vcu_gateway.bus.reconnect import Reconnector
from vcu_gateway.core.calls import EmergencyStop, NoteSent, Terminate
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.schedule import Schedule, Tick, lateness_at
from vcu_gateway.core.stop import Stop
from vcu_gateway.core.why import Explanation, Reasons, explained
from vcu_gateway.daemon import ticking_thread
from vcu_gateway.daemon.events import EventLog, LinkEvents, StopEvents
from vcu_gateway.daemon.log import log
from vcu_gateway.daemon.restart_state import RestartState
from vcu_gateway.daemon.ticking_thread import DrainPlan, ProcessorTime, WorkQueue
from vcu_gateway.units import NS_PER_MS, NS_PER_S, NS_PER_US

# No work for others is begun so shortly before the bus is read for a tick.
_PUNCTUAL_NS = 3_000_000
# Less is waited for busily: another wake-up would take as long and come late.
_SHORTEST_SLEEP_NS = 200_000
_FIRST_LOOK_WITHIN_S = 0.5
_PROCESSOR_TIME_EVERY_TICKS = 20


class LastTick(NamedTuple):
    """Result of the last tick, and how all is since; replaced whole by the ticking thread.

    Attributes:
        reasons: as they were at `explained_ns`, when the demand was `demand_age_ns` old.
        why_signature: the same object as long as the same is to be said.
        stop: what was known then of the latched CUT; None where none was latched.
    """

    result: TickResult
    reasons: Reasons
    why_signature: tuple[object, ...]
    explained_ns: int
    demand_age_ns: int | None
    stop: Stop | None

    @classmethod
    def explained(
        cls, gateway: Gateway, result: TickResult, now_ns: int, before: "LastTick | None" = None
    ) -> "LastTick":
        """The result, and why the gateway is as it is now; `before` saves what is the same."""
        reasons = gateway.reasons(now_ns)
        if before is not None and before.reasons == reasons:
            signature = before.why_signature
        else:
            signature = reasons.signature()
        age_ns = gateway.requests.arbiter.age_ns(now_ns)
        stop = None if reasons.latch is None else gateway.stop(now_ns)
        return cls(result, reasons, signature, now_ns, age_ns, stop)

    @property
    def why(self) -> Explanation:
        """The explanation, put together where it is read; on any thread."""
        judged_ns = self.result.snapshot.now_ns
        return explained(self.reasons, self.explained_ns, judged_ns, self.demand_age_ns)


class TickLoop:
    """Gateway and bus, ticked on the calling thread until `stop` or the end of `run`.

    Attributes:
        latest: the last tick; None before the first.
        schedule: every tick accounted for: ticks done, ticks skipped, lateness.
        silent_ticks: ticks that sent nothing, listening before talking.
    """

    def __init__(self, gateway: Gateway, connection: BusConnection, reopen_ms: int) -> None:
        self.gateway = gateway
        self.connection = connection
        self.schedule = Schedule(time.monotonic_ns(), gateway.settings.period_ns)
        self._observers: list[Callable[[TickResult], None]] = []
        self._stopping: str | None = None
        self._finished = False
        self.silent_ticks = 0
        self.work_queue = WorkQueue()
        self._drain_plan = DrainPlan()
        self.event_log = EventLog()
        self.reconnector = Reconnector(connection, reopen_ms)
        self._link_events = LinkEvents(gateway, connection, self.reconnector, self.event_log)
        self._stop_events = StopEvents(self.event_log)
        self.latest: LastTick | None = None
        self._restart_state: RestartState | None = None
        self._last_why: tuple[object, ...] = ()

    def stop(self, why: str) -> None:
        """Send safe frames, then end the loop."""
        self._stopping = self._stopping or why

    def add_observer(self, observer: Callable[[TickResult], None]) -> None:
        """Call this after each tick, on the ticking thread; what it raises ends the loop."""
        self._observers.append(observer)

    def keep(self, restart_state: RestartState) -> None:
        self._restart_state = restart_state
        self.add_observer(restart_state.observe)

    def emergency_stop(self) -> RequestResult:
        """Emergency stop of the gateway, kept before it is answered."""
        answer = self.gateway.apply(EmergencyStop())
        if self._restart_state is not None:
            left_ns = self.schedule.next_deadline_ns - time.monotonic_ns()
            self._restart_state.keep_emergency_stop(left_ns)
        return answer

    def handle_signals(self, on_hangup: Callable[[], None] | None = None) -> None:
        """SIGTERM and SIGINT end the loop, SIGHUP calls `on_hangup`; only in the main thread."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda number, _: self.stop(signal.Signals(number).name))
        if on_hangup is not None:
            signal.signal(signal.SIGHUP, lambda *_: self.work_queue.post(on_hangup))

    def run(self, duration_s: float | None = None) -> None:
        """Tick every period until stopped, or for `duration_s` seconds; then end safely.

        Raises UnavailableError where another gateway of this machine has the interface.
        """
        self.connection.acquire_lock()
        with ticking_thread.few_pauses():
            self._run(duration_s)
        self._log_end()

    def _run(self, duration_s: float | None) -> None:
        self._processor_time = ProcessorTime()
        self._link_events.begin(time.monotonic_ns())
        self.reconnector.start()
        self.reconnector.tried.wait(_FIRST_LOOK_WITHIN_S)
        schedule = self.schedule = Schedule(time.monotonic_ns(), self.schedule.period_ns)
        end_ns = None if duration_s is None else schedule.origin_ns + int(duration_s * NS_PER_S)
        try:
            while not self._finished:
                self._wait_and_tick(schedule, end_ns)
        finally:
            self.connection.read_waiting(time.monotonic_ns())
            self.reconnector.stop()
            self.connection.release_lock()
            self._processor_time.close()

    def _wait_and_tick(self, schedule: Schedule, end_ns: int | None) -> None:
        deadline_ns, plan = schedule.next_deadline_ns, self._drain_plan
        if plan.busy:
            middle_ns = deadline_ns - schedule.period_ns // 2
            self.work_queue.run_until(middle_ns, middle_ns)
            plan.read_between(self.connection.read_waiting(time.monotonic_ns()))
        wake_ns = deadline_ns - plan.lead_ns
        self.work_queue.run_until(wake_ns - _PUNCTUAL_NS, wake_ns)
        frames = self.connection.read_waiting(time.monotonic_ns())
        plan.read_before_tick(frames, time.monotonic_ns() - wake_ns)
        self._sleep_until(deadline_ns)
        tick = schedule.due(time.monotonic_ns())
        if tick is None:
            return
        if end_ns is not None and tick.deadline_ns >= end_ns:
            self.stop("duration reached")
        self._tick(tick)

    @staticmethod
    def _sleep_until(deadline_ns: int) -> None:
        left_ns = deadline_ns - time.monotonic_ns()
        if left_ns > _SHORTEST_SLEEP_NS:
            time.sleep(left_ns / NS_PER_S)
        while time.monotonic_ns() < deadline_ns:
            pass

    def _tick(self, tick: Tick) -> None:
        gateway, begun_ns = self.gateway, time.monotonic_ns()
        if self._stopping is not None:
            gateway.apply(Terminate())
        self.work_queue.run_waiting()
        self.connection.read_waiting(begun_ns)  # what came since it was read before the tick
        now_ns = time.monotonic_ns()
        self._link_events.before_tick(now_ns)
        result = gateway.tick(now_ns)
        if self._restart_state is not None:
            self._restart_state.before_sending()
        for frame in result.frames:
            # Not where the process was held up since the tick: what it decided is old by now.
            late = self.schedule.too_late(tick, time.monotonic_ns())
            sent = self.connection.count_unsent("late") if late else self.connection.send(frame)
            gateway.apply(NoteSent(frame, sent, now_ns))
        self.schedule.left(time.monotonic_ns())
        # What follows has the rest of the period.
        self._finished = gateway.finished
        self.silent_ticks += not result.frames
        self._report(tick, result)
        for observe in self._observers:
            observe(result)
        self._link_events.after_tick(now_ns)
        ticking_thread.collect_after(tick.index)

    def _report(self, tick: Tick, result: TickResult) -> None:
        """Emit what happened in this tick; most ticks have no events."""
        if tick.skipped:
            spent = self._processor_time.since_last()
            fields = {
                "skipped": tick.skipped,
                "late_ms": tick.lateness_ns / NS_PER_MS,
                "over_ms": spent.over_ns / NS_PER_MS,
                "processor_ms": spent.processor_ns / NS_PER_MS,
                "waited_ms": None if spent.waited_ns is None else spent.waited_ns / NS_PER_MS,
            }
            self.event_log.emit(Event("ticks_skipped", Severity.WARNING, fields))
        elif tick.index % _PROCESSOR_TIME_EVERY_TICKS == 0:
            self._processor_time.since_last()  # in every tick it would cost a tenth of it
        for event in result.events:
            self.event_log.emit(event)
        now_ns = result.snapshot.now_ns
        latest = self.latest = LastTick.explained(self.gateway, result, now_ns, self.latest)
        self._stop_events.after_tick(latest.stop, now_ns)
        if latest.why_signature != self._last_why:
            self._last_why = latest.why_signature
            log.info("why", sentence=latest.why.sentence())

    def refresh_why(self) -> None:
        """Explain `latest` again, where a request has changed something since the tick."""
        before, now_ns = self.latest, time.monotonic_ns()
        if before is not None:
            self.latest = LastTick.explained(self.gateway, before.result, now_ns, before)

    def _log_end(self) -> None:
        schedule, counters = self.schedule, self.connection.counters
        p50_ns, p99_ns = (lateness_at(schedule.lateness_counts, share) for share in (0.5, 0.99))
        log.info(
            "stopped",
            reason=self._stopping,
            mode=self.gateway.mode.value,
            elapsed_s=round((time.monotonic_ns() - schedule.origin_ns) / NS_PER_S, 3),
            ticks=schedule.ticks,
            skipped=schedule.skipped,
            silent_ticks=self.silent_ticks,
            sent_frames=counters.sent,
            unsent_frames=counters.refused,
            lateness_p50_below_us=None if p50_ns is None else p50_ns // NS_PER_US,
            lateness_p99_below_us=None if p99_ns is None else p99_ns // NS_PER_US,
            receiver_bugs=counters.receiver_bugs,
        )
