"""The metrics: what Prometheus reads of the gateway at the moment of the scrape."""

import gc
import itertools
import platform
import sys

import pytest
from prometheus_client import generate_latest

from tests.core.simulated_drive import (
    COMMAND_IDS,
    MS,
    RECEIVED,
    Drive,
    active,
    data,
    in_mode,
    standby,
)
from tests.monitoring.program import MOTOR, STARTED_S, TUNED, Program, Scrape, driven
from tests.recorder.told import STATUS
from vcu_gateway import __version__, exporter
from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.config import Config, digest
from vcu_gateway.core import calls
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.codec import Reason
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, PowerMode
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.schedule import LATENESS_BOUNDS_NS
from vcu_gateway.core.state import Quality
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.exporter import prometheus

LATENESS = "tick_lateness_seconds"
BENCH = ControllerDemand(throttle_pct=30, power_mode=PowerMode.NORMAL)


def exposed_names(scrape: Scrape) -> set[str]:
    """The names of the samples, a histogram's as the family's."""
    names = {name for name, _ in scrape.samples}
    histogram = f"vcu_gateway_{LATENESS}"
    return {histogram if name.startswith(histogram) else name for name in names}


# The text.


def test_every_family_is_described_and_has_a_sample_in_a_driven_gateway():
    scrape = driven().scrape()
    for family in exporter.FAMILIES:
        assert f"# HELP {family.name} {family.help}" in scrape.text
        assert f"# TYPE {family.name} {family.kind}" in scrape.text
    assert {family.name for family in exporter.FAMILIES} <= exposed_names(scrape)


def test_every_sample_belongs_to_a_family_and_has_exactly_its_labels():
    families = {family.name: family for family in exporter.FAMILIES}
    for name, labels in driven().scrape().samples:
        family = families[name.removesuffix("_bucket").removesuffix("_count")]
        given = {label for label, _ in labels}
        assert given == set(() if name.endswith("_count") else family.labels), name


def test_names_follow_the_conventions():
    names = [family.name for family in exporter.FAMILIES]
    assert len(names) == len(set(names))
    for family in exporter.FAMILIES:
        assert family.name.startswith(("vcu_gateway_", "process_"))
        assert family.name.endswith("_total") == (family.kind == "counter"), family.name
        assert family.help.endswith("."), family.name
        assert not family.name.endswith(("_ms", "_ns", "_pct", "_percent")), family.name


def test_the_process_is_there_with_cpu_memory_and_files():
    families = Program().scrape().families
    assert families["process_resident_memory_bytes"].samples[0].value > 1_000_000
    assert families["process_cpu_seconds"].samples[0].value > 0
    assert families["process_open_fds"].samples[0].value > 2


# The vehicle.


@pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.name)
def test_exactly_the_mode_of_the_last_tick_is_1(mode):
    program = Program(in_mode(mode))
    program.tick()
    assert program.scrape().by("mode", "mode") == {m.value: float(m is mode) for m in Mode}


def test_nothing_is_said_of_mode_causes_and_demand_before_the_first_tick():
    scrape = Program().scrape()
    for name in ("mode", "fault_latched", "effect", "cause_seconds", "demand_fresh"):
        assert scrape.of(f"vcu_gateway_{name}") == {}
        assert f"# HELP vcu_gateway_{name} " in scrape.text


@pytest.mark.parametrize(("code", "fault_class"), [(2, FaultClass.DRIVER), (3, FaultClass.SERVICE)])
def test_a_latched_fault_is_told_with_the_level_of_its_reset(code, fault_class):
    program = Program(active()).run(100)
    assert set(program.scrape().by("fault_latched", "fault_class").values()) == {0.0}
    program.drive.codes["BMS_Status.CellUndervoltage"] = code
    program.run(600)
    expected = {one.value: float(one is fault_class) for one in FaultClass}
    assert program.scrape().by("fault_latched", "fault_class") == expected


def test_every_effect_that_counts_is_1_and_every_cause_tells_how_long_it_has_counted():
    program = Program(active())
    program.drive.codes["BMS_Status.DischargeOvercurrent"] = 1
    program.run(1000)
    scrape, why = program.scrape(), program.drive.gateway.why(program.drive.now_ns)
    limits = {Effect.POWER_LIMIT, Effect.REGEN_LIMIT}
    assert scrape.by("effect", "effect") == {e.value: float(e in limits) for e in Effect}
    assert len(why.limits) == 2
    for held in why.limits:
        since_s = scrape.value(
            "cause_seconds",
            cause="code",
            subject="BMS_Status.DischargeOvercurrent",
            effect=held.finding.effect.value,
        )
        assert since_s == pytest.approx((program.drive.now_ns - held.since_ns) / 1e9)
    program.drive.codes.clear()
    program.run(2000)
    assert program.scrape().of("vcu_gateway_cause_seconds") == {}
    assert set(program.scrape().by("effect", "effect").values()) == {0.0}


@pytest.mark.parametrize("mode", [Mode.STARTING, Mode.ACTIVE, Mode.FAULT], ids=str)
def test_the_effects_are_those_that_the_core_counts(mode):
    program = Program(in_mode(mode))
    program.drive.codes |= {
        "BMS_Status.CellOvervoltage": 2,
        "BMS_Status.TemperatureImbalance": 1,
        "BMS_Status.CellUndervoltage": 2,
        "PCU1_Status1.TemperatureProtectLevel": 1,
    }
    program.run(1500)
    standing = {name for name, on in program.scrape().by("effect", "effect").items() if on}
    assert standing == {effect.value for effect in program.drive.gateway.causes.effects()}
    assert len(standing) >= 4


def test_without_a_demand_there_is_no_age_and_nothing_is_asked():
    program = Program()
    program.drive.demanded = None
    program.run(100)
    scrape = program.scrape()
    assert scrape.value("demand_fresh") == 0
    assert scrape.value("demand_age_seconds") is None
    assert scrape.of("vcu_gateway_demand_throttle_ratio") == {}
    assert scrape.of("vcu_gateway_demand_brake_ratio") == {}


def test_a_demand_has_its_age_at_the_last_tick():
    program = Program(standby()).run(50)
    scrape = program.scrape()
    assert scrape.value("demand_fresh") == 1
    assert scrape.value("demand_age_seconds") == pytest.approx(0, abs=1e-6)


def test_an_expired_demand_keeps_its_age_and_asks_nothing():
    program = Program(standby()).run(50)
    program.drive.demanded = None
    program.run(300)
    scrape = program.scrape()
    assert scrape.value("demand_fresh") == 0
    assert scrape.value("demand_age_seconds") == pytest.approx(0.3)
    assert scrape.of("vcu_gateway_demand_throttle_ratio") == {}


def test_a_bench_demand_is_fresh_and_has_no_age():
    program = Program(Drive(bench_demand=BENCH))
    program.drive.demanded = None
    program.tick()
    scrape = program.scrape()
    assert scrape.value("demand_fresh") == 1
    assert scrape.value("demand_age_seconds") is None
    assert scrape.value("demand_throttle_ratio", controller="PCU1") == 0.3


def test_while_the_gateway_listens_no_command_is_shown():
    program = Program(Drive()).run(500)
    scrape = program.scrape()
    assert [name for name in exposed_names(scrape) if "command" in name] == []
    assert scrape.value("ticks_silent_total") == 10


def test_the_commands_are_those_of_the_last_tick():
    program = Program(active())
    program.drive.demanded = ControllerDemand(
        throttle_pct=60, power_mode=PowerMode.TURBO, speed_limit_rpm=11_500, power_limit_w=7000
    )
    program.run(200)  # SpeedLimit has come down, the throttle is still on its way
    scrape, told = program.scrape(), program.loop.latest.result.commands
    for name in CONTROLLERS:
        assert 0 < told[name].throttle_pct < 60
        ratio = scrape.value("command_throttle_ratio", controller=name)
        assert ratio == told[name].throttle_pct / 100
        assert scrape.value("demand_throttle_ratio", controller=name) == 0.6
        assert scrape.value("command_speed_limit_rpm", controller=name) == 11_500
        assert scrape.value("command_power_limit_watts", controller=name) == 7000
        assert scrape.value("command_power_cut", controller=name) == 0
        modes = {
            mode: scrape.value("command_power_mode", controller=name, power_mode=mode)
            for mode in ("eco", "normal", "turbo", "safety")
        }
        assert modes == {"eco": 0, "normal": 0, "turbo": 1, "safety": 0}


def test_brake_regeneration_and_reverse_are_told_apart():
    program = Program(standby(regen_min_rpm=0))
    program.drive.demanded = ControllerDemand(motor_reverse=True)
    program.run(200)
    assert program.scrape().by("command_motor_reverse", "controller") == {"PCU1": 1, "PCU2": 1}
    assert program.scrape().by("command_regen_brake", "controller") == {"PCU1": 0, "PCU2": 0}
    assert program.drive.arm().granted
    program.drive.demanded = ControllerDemand(motor_reverse=True, brake_pct=10, regen_brake=True)
    program.run(100)
    scrape = program.scrape()
    assert scrape.by("command_motor_reverse", "controller") == {"PCU1": 1, "PCU2": 1}
    assert scrape.by("command_regen_brake", "controller") == {"PCU1": 1, "PCU2": 1}
    assert scrape.by("command_brake_ratio", "controller") == {"PCU1": 0.1, "PCU2": 0.1}
    assert scrape.by("demand_brake_ratio", "controller") == {"PCU1": 0.1, "PCU2": 0.1}


def test_a_cut_is_shown_in_the_commands():
    program = Program(active())
    program.drive.gateway.requests.emergency_stop()
    program.run(100)
    assert program.scrape().by("command_power_cut", "controller") == {"PCU1": 1, "PCU2": 1}


def test_a_stop_is_told_by_its_stage_and_by_what_each_controller_says():
    program = Program(active()).run(50)
    assert set(program.scrape().by("stop_stage", "stage").values()) == {0.0}
    assert program.scrape().of("vcu_gateway_stop_obeyed") == {}
    program.drive.codes["PCU2_Status1.PowerCut"] = 1
    program.drive.gateway.requests.emergency_stop()
    program.run(100)
    stages = program.scrape().by("stop_stage", "stage")
    assert stages == {"latched": 0, "sent": 0, "on the bus": 1, "cut": 0, "not obeyed": 0}
    assert program.scrape().of("vcu_gateway_stop_obeyed") == {}
    program.run(600)
    assert program.scrape().value("stop_stage", stage="not obeyed") == 1
    assert program.scrape().by("stop_obeyed", "controller") == {"PCU1": 0, "PCU2": 1}


def test_the_limits_are_those_of_the_configuration():
    scrape = Program().scrape()
    assert scrape.value("limit_speed_rpm") == 12_000
    assert scrape.value("limit_power_watts") == 60_000
    assert scrape.value("limit_derated_power_watts") == 10_000
    assert scrape.value("limit_regen_ratio") == 0.2


def test_the_drive_mode_is_1_and_the_one_that_waits_is_told_apart():
    program = Program(active(tuning=TUNED))
    program.drive.demanded = ControllerDemand(throttle_pct=30)
    program.run(200)
    assert program.scrape().by("drive_mode", "mode") == {"eco": 1, "sport": 0}
    assert program.scrape().by("drive_mode_waits", "mode") == {"eco": 0, "sport": 0}
    call = calls.SetDriveMode("sport", FaultClass.DRIVER, program.drive.now_ns)
    program.drive.gateway.apply(call)
    program.run(200)
    assert program.scrape().by("drive_mode", "mode") == {"eco": 1, "sport": 0}
    assert program.scrape().by("drive_mode_waits", "mode") == {"eco": 0, "sport": 1}
    program.drive.demanded = ControllerDemand()
    program.run(50)
    assert program.scrape().by("drive_mode", "mode") == {"eco": 0, "sport": 1}
    assert program.scrape().by("drive_mode_waits", "mode") == {"eco": 0, "sport": 0}


def test_a_curve_has_its_limit_now_and_whether_its_input_is_known():
    program = Program(active(tuning=TUNED)).run(100)
    assert program.scrape().value("curve_cap", curve=MOTOR, unit="W") == 60_000
    assert program.scrape().value("curve_input_known", curve=MOTOR) == 1
    program.drive.codes |= {f"PCU{n}_Status1.MotorTemperature": 110 for n in (1, 2)}
    program.run(600)
    assert program.scrape().value("curve_cap", curve=MOTOR, unit="W") == 6000
    program.drive.silent = {"PCU1_Status1"}
    program.run(2000)
    assert program.scrape().value("curve_input_known", curve=MOTOR) == 0


def test_without_tuning_nothing_is_said_of_drive_modes_and_curves():
    names = exposed_names(Program(active()).run(100).scrape())
    assert not [name for name in names if "drive_mode" in name or "curve" in name]


def test_only_good_signals_are_shown():
    program = Program(standby())
    program.drive.silent = {"IMU_Attitude"}
    program.drive.codes["BMS_Temperatures.PackTemperature5"] = 255
    program.run(1000)
    snapshot = program.drive.gateway.snapshot(program.drive.now_ns)
    readings = {
        (spec.name, reading.name, reading.unit): reading
        for spec in snapshot.messages
        for reading in snapshot.readings(spec.name)
    }
    shown = {
        (one["message"], one["signal"], one["unit"]): value
        for labels, value in program.scrape().of("vcu_gateway_signal").items()
        for one in [dict(labels)]
    }
    good = {key: r.value for key, r in readings.items() if r.quality is Quality.GOOD}
    assert shown == good
    assert shown["BMS_Status", "SOC", "%"] == 80
    assert ("BMS_Temperatures", "PackTemperature5", "degC") not in shown
    assert ("IMU_Attitude", "AttitudeX", "deg") not in shown


# The bus.


def test_a_message_that_never_came_has_no_age_and_is_stale():
    program = Program()
    program.drive.silent = set(RECEIVED)
    program.tick()
    scrape = program.scrape()
    assert scrape.of("vcu_gateway_message_age_seconds") == {}
    assert set(scrape.by("message_stale", "message").values()) == {1.0}
    assert set(scrape.by("message_frames_total", "message").values()) == {0.0}
    assert len(scrape.by("message_stale", "message")) == len(RECEIVED)


def test_messages_are_told_with_age_count_and_staleness():
    program = Program(standby())
    program.drive.silent = {"BMS_Status"}
    program.tick()
    before = program.scrape()
    program.run(1700)
    scrape = program.scrape()
    age_s = program.scrape().value("message_age_seconds", message="BMS_Status")
    assert age_s == pytest.approx(before.value("message_age_seconds", message="BMS_Status") + 1.7)
    assert scrape.value("message_stale", message="BMS_Status") == 1
    assert scrape.value("message_stale", message="IMU_Attitude") == 0
    for name, grown in (("BMS_Status", 0), ("IMU_Attitude", 170), ("PCU1_Status2", 34)):
        counts = [s.value("message_frames_total", message=name) for s in (before, scrape)]
        assert counts[1] - counts[0] == grown


def test_marked_and_out_of_order_frames_are_counted():
    program = Program(standby())
    program.drive.codes["PCU1_Status2.MotorSpeed"] = 65535
    program.run(500)
    program.drive.receive("PCU1_Status2", program.drive.now_ns - 1000 * MS)
    scrape = program.scrape()
    assert scrape.value("message_marked_frames_total", message="PCU1_Status2") == 10
    assert scrape.value("message_marked_frames_total", message="PCU2_Status2") == 0
    assert scrape.value("frames_out_of_order_total") == 1


@pytest.mark.parametrize(
    ("reason", "fields"),
    [
        (Reason.ERROR, {"error": True}),
        (Reason.REMOTE, {"remote": True}),
        (Reason.STANDARD, {"extended": False}),
        (Reason.UNKNOWN, {"can_id": 0x18FECA15}),
        (Reason.FOREIGN_SOURCE, {"can_id": 0x1808D0F5}),
        (Reason.SHORT, {"data": bytes(7)}),
        (Reason.LONG, {"data": bytes(9)}),
    ],
)
def test_a_rejected_frame_counts_for_its_reason_alone(reason, fields):
    program = Program()
    healthy = {"can_id": 0x1808D0F4, "data": data("BMS_Status"), "arrival_ns": 0}
    program.drive.gateway.receive(Frame(**healthy | fields))
    rejected = program.scrape().by("frames_rejected_total", "reason")
    assert rejected == {one.value: float(one is reason) for one in Reason}


def test_what_was_sent_confirmed_foreign_unsent_and_blocked_is_counted():
    program = Program(standby())
    before = program.scrape()
    program.run(500)
    program.drive.receive_foreign("PCU2")
    program.connection.count_unsent("late")
    program.connection.count_unsent("ENODEV")
    scrape = program.scrape()
    assert scrape.value("frames_sent_total") - before.value("frames_sent_total") == 20
    confirmed = [s.by("frames_confirmed_total", "controller") for s in (before, scrape)]
    assert {name: confirmed[1][name] - confirmed[0][name] for name in CONTROLLERS} == {
        "PCU1": 10,
        "PCU2": 10,
    }
    assert scrape.by("frames_foreign_total", "controller") == {"PCU1": 0, "PCU2": 1}
    assert before.by("frames_unsent_total", "reason") == {
        "closed": 0,
        "late": 0,
        "ENOBUFS": 0,
    }
    assert scrape.by("frames_unsent_total", "reason") == {
        "closed": 0,
        "late": 1,
        "ENOBUFS": 0,
        "ENODEV": 1,
    }
    assert scrape.of("vcu_gateway_frames_blocked_total") == {}
    program.drive.gateway.transmitter.gate.check(
        0, 0, bytes(8), armed=False, demanded=None, speeds_rpm=(0.0, 0.0), now_ns=0
    )
    assert program.scrape().by("frames_blocked_total", "rule") == {"identifier": 1}


def test_received_frames_and_bugs_of_the_receiver_are_the_connections():
    program = Program()
    program.connection.counters.received, program.connection.counters.receiver_bugs = 123, 4
    scrape = program.scrape()
    assert scrape.value("frames_received_total") == 123
    assert scrape.value("receiver_bugs_total") == 4


def test_dropped_frames_are_shown_only_where_they_can_be_known():
    assert Program(interface="virtual").scrape().value("frames_dropped_total") is None
    assert Program(interface="socketcan").scrape().value("frames_dropped_total") == 0


@pytest.mark.parametrize(
    ("can_id", "bits", "state"),
    [
        (0x004, 0x08, LinkState.WARNING),
        (0x004, 0x20, LinkState.PASSIVE),
        (0x040, 0, LinkState.BUS_OFF),
        (0x100, 0, LinkState.UP),
    ],
)
def test_the_link_is_told_with_its_state_and_the_time_in_it(can_id, bits, state):
    program = Program(standby())
    since_ns = program.drive.now_ns
    program.drive.open_link(since_ns)
    error = Frame(can_id, bytes([0, bits, 0, 0, 0, 0, 0, 0]), since_ns, error=True)
    program.drive.gateway.receive(error)
    program.drive.now_ns += 1500 * MS
    scrape = program.scrape()
    assert scrape.by("link_state", "state") == {s.value: float(s is state) for s in LinkState}
    assert scrape.value("link_state_seconds") == 1.5


def test_a_lost_link_is_lost_whatever_the_error_frames_said():
    program = Program(standby())
    program.drive.gateway.apply(calls.LoseLink(program.drive.now_ns))
    expected = {s.value: float(s is LinkState.LOST) for s in LinkState}
    assert program.scrape().by("link_state", "state") == expected


def test_what_is_younger_than_the_scrape_is_0_s_old():
    program = Program()
    program.drive.open_link(program.drive.now_ns + 3 * MS)
    assert program.scrape().value("link_state_seconds") == 0


def test_no_frame_whatsoever_makes_more_label_sets():
    """A flood of foreign and unknown frames costs no more than the sixteen known subjects."""
    program = driven()

    def label_sets() -> set[tuple[str, frozenset[tuple[str, str]]]]:
        return set(program.scrape().samples)

    before = label_sets()
    identifiers = itertools.chain(
        range(0, 1 << 29, 400_009),
        (own & 0x03FFFFFF | p << 26 for own in COMMAND_IDS.values() for p in range(8)),
    )
    for can_id in identifiers:
        for frame in (Frame(can_id, bytes(8), 0), Frame(can_id, bytes(3), 0)):
            program.drive.gateway.receive(frame)
        program.tick() if can_id & 0xFFFF == COMMAND_IDS["PCU1"] & 0xFFFF else None
    program.run(200)
    more = {(name, dict(labels).get("cause")) for name, labels in label_sets() - before}
    assert {name for name, _ in more} <= {"vcu_gateway_cause_seconds"}
    assert len(label_sets() - before) <= 2 * 8 + 8


# The program.


def test_lateness_is_a_cumulative_histogram_in_seconds_that_counts_every_tick():
    program = Program()
    lateness_ns = [0, 40_000, 50_000, 50_001, 900_000, 24_000_000, 24_999_999]
    for late_ns in lateness_ns:
        program.tick(late_ns)
    scrape = program.scrape()
    buckets = {
        float(bound): count for bound, count in scrape.by(f"{LATENESS}_bucket", "le").items()
    }
    assert list(buckets) == [*(bound / 1e9 for bound in LATENESS_BOUNDS_NS), float("inf")]
    assert list(buckets.values()) == sorted(buckets.values())
    for bound_s, count in buckets.items():
        assert count == sum(late / 1e9 <= bound_s for late in lateness_ns)
    assert buckets[float("inf")] == scrape.value(f"{LATENESS}_count") == 7
    assert scrape.value("ticks_total") == 7


def test_skipped_ticks_are_counted():
    program = Program()
    schedule = program.loop.schedule
    schedule.due(schedule.next_deadline_ns + 4 * schedule.period_ns)
    scrape = program.scrape()
    assert scrape.value("ticks_skipped_total") == 4
    assert scrape.value("ticks_total") == 1
    assert scrape.value("tick_period_seconds") == 0.05


def test_the_apis_own_figures_are_passed_on():
    program = Program()
    program.api |= {"clients": 3, "accepted": 10, "turned_away": 2, "requests": 500}
    program.api |= {"errors": {"method_not_found": 4}, "closed": {"slow": 1}, "lost_updates": 7}
    scrape = program.scrape()
    assert scrape.value("api_clients") == 3
    assert scrape.value("api_connections_total") == 10
    assert scrape.value("api_connections_turned_away_total") == 2
    assert scrape.value("api_requests_total") == 500
    errors = dict.fromkeys((code.name.lower() for code in ErrorCode), 0) | {"method_not_found": 4}
    assert scrape.by("api_errors_total", "code") == errors
    assert scrape.by("api_connections_closed_total", "reason") == {"slow": 1}
    assert scrape.value("api_lost_updates_total") == 7


def test_what_runs_since_when_and_with_which_configuration():
    program = Program()
    program.drive.now_ns += 90_000 * MS
    program.facts.log_lines_dropped = lambda: 11
    scrape = program.scrape()
    assert scrape.value("build_info", version=__version__, python=platform.python_version()) == 1
    assert scrape.value("config_info", config_digest=digest(Config()), protocol_digest="0123") == 1
    assert scrape.value("start_time_seconds") == STARTED_S
    assert scrape.value("uptime_seconds") == 90
    assert scrape.value("starts_total") == 2
    assert scrape.value("log_lines_dropped_total") == 11


def test_starts_that_are_not_known_are_absent():
    program = Program()
    program.facts.start = None
    assert program.scrape().value("starts_total") is None


# The scrape itself.


def test_a_scrape_changes_nothing_that_it_reads():
    program = driven()
    before = program.drive.twin()
    for _ in range(3):
        program.scrape()
    program.drive.tick()
    before.tick()
    assert program.drive.commands == before.commands
    assert program.drive.result.events == before.result.events
    assert program.drive.sentence == before.sentence


def test_memory_does_not_grow_over_200_scrapes():
    reading = driven().reading()

    def blocks_after(scrapes: int) -> int:
        for _ in range(scrapes):
            generate_latest(prometheus.registry(lambda: reading))
        gc.collect()  # empties the interpreter's own stores as well
        return sys.getallocatedblocks()

    before = blocks_after(20)
    assert blocks_after(200) - before < 100


# The recorder.


def test_a_recorder_that_tells_its_state_is_up_and_counted():
    scrape = Program().scrape()
    assert scrape.value("recorder_up") == 1
    assert scrape.value("recorder_frames_total") == STATUS.totals.frames
    assert scrape.value("recorder_connections") == 1
    assert scrape.by("recorder_disk_state", "state") == {
        "ok": 1,
        "full": 0,
        "failing": 0,
        "stalled": 0,
    }


@pytest.mark.parametrize(("age_s", "up"), [(10.0, 1), (10.1, 0)])
def test_one_that_says_nothing_any_more_is_down_and_tells_no_old_figures(age_s, up):
    program = Program()
    program.recorder_age_s = age_s
    scrape = program.scrape()
    assert scrape.value("recorder_up") == up
    assert (scrape.value("recorder_frames_total") is None) == (not up)


def test_without_a_recorder_nothing_is_said_of_one():
    program = Program()
    program.recorder = None
    assert not [name for name in exposed_names(program.scrape()) if "recorder" in name]


def test_what_is_not_known_yet_is_absent():
    program = Program()
    program.recorder = STATUS._replace(longest_sync_s=None, free_bytes=None)
    scrape = program.scrape()
    assert scrape.value("recorder_sync_seconds") is None
    assert scrape.value("recorder_free_bytes") is None
    assert scrape.value("recorder_up") == 1
