"""View models for tests: the core driving the simulated vehicle, as the API reports it."""

import copy
import functools
import threading
from collections.abc import Callable
from datetime import datetime
from typing import Any

from tests.simulator.driving import CRUISE, S_NS, START_NS
from vcu_gateway import simulator
from vcu_gateway.api.results import Cause, ControllerStopState, Health, StopStageName, StopState
from vcu_gateway.client import ClientError
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.daemon.loop import LastTick
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.server import views
from vcu_gateway.watch.source import SourceProblem, ViewModel

HEALTH: Health = {
    "pid": 812,
    "uptime_ms": 764_000.0,
    "start_time_s": 1_700_000_000.0,
    "starts": 1,
    "unexpected_restarts": 0,
    "config_file": "/etc/vcu-gateway/gateway.yaml",
    "config_digest": "5d41402abc4b2a76b9719d911017c592",
    "protocol_digest": "7d793037a0760186574b0282f2f435e7",
    "link": {
        "interface": "socketcan",
        "channel": "can0",
        "state": "up",
        "since_ms": 763_400.0,
        "lost": None,
    },
    "ticks": {
        "period_ms": 50.0,
        "done": 15_268,
        "skipped": 0,
        "silent": 20,
        "lateness_p50_us": 104.0,
        "lateness_p90_us": 171.0,
        "lateness_p99_us": 223.0,
        "lateness_max_us": 238.0,
        "lateness_ticks": 1200,
        "lateness_histogram": [],
    },
    "frames": {
        "received": 273_294,
        "rejected": {},
        "out_of_order": 0,
        "unjudged": 0,
        "dropped": 0,
        "sent": 30_496,
        "unsent": {},
        "confirmed": {"PCU1": 15_248, "PCU2": 15_248},
        "foreign_commands": {"PCU1": 0, "PCU2": 0},
        "blocked_by_gate": {},
        "receiver_bugs": 0,
    },
    "api": {
        "clients": 2,
        "accepted": 5,
        "turned_away": 0,
        "gave_way": 0,
        "stopped_anyway": 0,
        "requests": 4_711,
        "errors": {},
        "closed": {},
        "lost_updates": 0,
    },
    "recorder": {"connected": True, "datagrams": 15_268, "lost_datagrams": 0, "lost_frames": 0},
    "log_lines_dropped": 0,
    "process": {
        "cpu_time_s": 31.5,
        "resident_memory_bytes": 60_000_000,
        "virtual_memory_bytes": 300_000_000,
        "open_fds": 16,
        "max_fds": 1024,
    },
    "versions": {
        "vcu_gateway": "0.1.0",
        "python": "3.11.7",
        "python_can": "4.6.1",
        "kernel": "Linux 6.18.0",
    },
}


@functools.cache
def _driven(seconds: float, soc_pct: float = 80.0) -> ViewModel:
    codec = Codec(dbc.load(packaged("vcu.dbc")))
    gateway = Gateway(codec, Settings(bench_demand=CRUISE, auto_arm=True), START_NS)
    nodes = simulator.build(codec, START_NS, soc_pct=soc_pct)
    now_ns, tick_ns = START_NS, START_NS + 7_000_000
    while tick_ns < START_NS + seconds * S_NS:
        now_ns = min(tick_ns, nodes.next_due_ns())
        for frame in nodes.due(now_ns):
            gateway.receive(Frame(frame.can_id, frame.data, now_ns))
        if now_ns == tick_ns:
            result = gateway.tick(now_ns)
            for sent in result.frames:
                gateway.sent(sent, True, now_ns)
                gateway.receive(Frame(sent.can_id, sent.data, now_ns, own_echo=True))
                nodes.receive(sent.can_id, sent.data, now_ns)
            tick_ns += gateway.settings.period_ns
    latest = LastTick.explained(gateway, result, result.snapshot.now_ns)
    state = views.state(gateway, latest, result.snapshot.now_ns)
    return ViewModel(state, views.why(latest.why), HEALTH, views.tuning(gateway, now_ns))


def driving() -> ViewModel:
    """A healthy vehicle under way, to change at will."""
    return copy.deepcopy(_driven(8.0))


def limited() -> ViewModel:
    """Under way with a battery that is nearly empty."""
    return copy.deepcopy(_driven(8.0, soc_pct=14.0))


def tuned(current: str = "eco", requested: str = "eco") -> ViewModel:
    """Under way in a drive mode, with a curve that limits."""
    view = driving()
    assert view.tuning is not None
    assert view.why is not None
    view.tuning["drive_mode"] = {
        "current": current,
        "requested": requested,
        "modes": ["eco", "sport"],
        "left_by_service": [],
    }
    detail = "101 °C: power at most 10.8 kW"
    key = "curves.power_limit_w.by_motor_temperature_c"
    view.why["limits"] = [cause("cap", cause=key, subject="motor temperature", detail=detail)]
    if requested != current:
        view.why["waits"] = [f"drive mode {requested} waits for the pedal's release"]
    return view


def pedals(*doubts: str) -> ViewModel:
    """Under way by pedals on CAN; with doubts their first track is not known."""
    view = driving()
    assert view.tuning is not None
    view.tuning["pedals"] = {
        "message": "Pedals_Position",
        "throttle_pct": None if doubts else 42.0,
        "throttle_track2_pct": 41.0,
        "difference_pct": None if doubts else 1.0,
        "brake_pct": 0.0,
        "doubts": list(doubts),
        "sentence": "; ".join(["second track 41 %, brake 0 %", *doubts])
        if doubts
        else "throttle 42 %, second track 41 %, difference 1 %, brake 0 %",
    }
    return view


def starting() -> ViewModel:
    """Just started: most has never been heard."""
    return copy.deepcopy(_driven(0.06))


def cause(effect: str = "stop", **changes: Any) -> Cause:
    """One reason as the API tells it."""
    made = {
        "cause": "stale",
        "subject": "BMS_Status",
        "detail": "1700 ms",
        "effect": effect,
        "since_ms": 3200.0,
        "stands": True,
    }
    return made | changes  # type: ignore[return-value]


def faulty() -> ViewModel:
    """Latched, with reasons of every kind, and counts that ought to be 0."""
    view = driving()
    state, why, health = view.state, view.why, view.health
    assert state is not None
    assert why is not None
    assert health is not None
    state["mode"] = why["mode"] = "fault"
    for command in state["commands"].values():
        command |= {"throttle_pct": 0.0, "power_mode": "safety", "power_limit_w": 0.0}
    state["stop"] = stop()
    why["latch"] = {
        "fault_class": "service",
        "reason": "BMS_Status.Overtemperature 2 (level2): cut",
        "since_ms": 4300.0,
    }
    hot = {"cause": "code", "subject": "BMS_Status.Overtemperature", "detail": "2 (level2)"}
    why["blocks"] = [cause("cut", **hot)]
    why["limits"] = [cause("power limit", subject="PCU1_Status1", stands=False)]
    why["alarms"] = [cause("alarm", subject="ARD2_SteeringWheel", detail="never received")]
    why["next_step"] = "first: BMS_Status.Overtemperature 2 (level2) stands; then service reset"
    why["summary"] = "stopped, blocked by the battery: Overtemperature 2, since 3.2 s"
    why["sentence"] = (
        "fault; latched (service): BMS_Status.Overtemperature 2 (level2): cut; blocked by "
        "BMS_Status.Overtemperature 2 (level2): cut (for 4.3 s); limited by PCU1_Status1 1700 ms:"
        " power limit (for 3.2 s, gone and held); alarm ARD2_SteeringWheel never received: alarm"
        " (for 3.2 s); demand of driver 30 ms old; " + why["next_step"]
    )
    wheels = state["messages"]["ARD2_SteeringWheel"]
    wheels |= {"age_ms": None, "period_ms": None, "stale": True, "frame_count": 0}
    for signal in wheels["signals"].values():
        signal |= {"value": None, "raw": None, "quality": "never"}
    pcu1 = state["messages"]["PCU1_Status1"]
    pcu1 |= {"age_ms": 1712.0, "stale": True}
    for signal in pcu1["signals"].values():
        signal["quality"] = "stale"
    state["messages"]["PCU2_Status2"]["signals"]["MotorSpeed"] |= {
        "value": 6400,
        "raw": 6400,
        "quality": "out of range",
    }
    health["frames"] |= {"rejected": {"unknown": 3, "length": 1}, "dropped": 12}
    health["ticks"]["skipped"] = 2
    return view


def stop(
    stage: StopStageName = "on the bus",
    sentence: str = "Stop on the bus; waiting for PCU1 and PCU2 to confirm",
) -> StopState:
    """A stop as the API tells it; its controllers are not shown."""
    known: ControllerStopState = {
        "sent_ms": 4300.0,
        "echoed_ms": 4300.0,
        "obeyed": None,
        "judged_ms": None,
        "power_cut": None,
        "throttle_pct": None,
        "missing": "has not confirmed yet",
    }
    return {
        "latched_ms": 4300.0,
        "reason": "BMS_Status.Overtemperature 2 (level2): cut",
        "stage": stage,
        "sentence": sentence,
        "controllers": {"PCU1": known, "PCU2": known},
    }


def unreachable() -> ViewModel:
    """The gateway that drove has gone."""
    gone = driving()
    problem = SourceProblem(
        "/run/vcu-gateway/control.sock: Connection refused; is the gateway running?",
        datetime(2026, 5, 4, 14, 3, 11),
    )
    return ViewModel(gone.state, gone.why, gone.health, gone.tuning, problem)


class Scripted:
    """View source with a settable view model, which records the requests."""

    def __init__(self, view: ViewModel | None = None) -> None:
        self.view = driving() if view is None else view
        self.asked: list[str] = []
        self.refusal = ""
        self.may_answer = threading.Event()
        self.may_answer.set()
        self.looks = 0
        self.on_look: Callable[[], None] = lambda: None

    def latest(self) -> ViewModel:
        self.looks += 1
        self.on_look()
        return self.view

    def request(self, what: str) -> None:
        self.asked.append(what)
        self.may_answer.wait()
        if self.refusal:
            raise ClientError(self.refusal)
