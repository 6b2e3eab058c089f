"""Prometheus's own opinion; `fetch-promtool` beside this file gets promtool."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from tests.core.simulated_drive import active
from tests.monitoring.paths import ALERTS, DASHBOARD, MONITORING
from tests.monitoring.program import MOTOR, TUNED, Program, driven

CACHED = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "vcu-gateway/promtool"
EVERY_S = 5
STEPS = 150
BREAK_AT = 100
ASKED_AT_S = 720

Series = dict[str, str]


def name(metric: str, **labels: str) -> str:
    """A series of one gateway, as promtool writes it."""
    labels = {**labels, "instance": "vehicle", "job": "vcu-gateway"}
    inside = ",".join(f'{label}="{value}"' for label, value in sorted(labels.items()))
    return f"{metric}{{{inside}}}"


def gateway(metric: str, **labels: str) -> str:
    return name(f"vcu_gateway_{metric}", **labels)


def cause(word: str, effect: str) -> str:
    return gateway("cause_seconds", cause=word, effect=effect, subject="some signal")


def constant(value: float) -> str:
    return f"{value:g}+0x{STEPS}"


def step(before: str = "0", after: str = "1") -> str:
    """One value until BREAK_AT, another from then on; "_" is none."""
    first = f"_x{BREAK_AT}" if before == "_" else f"{before}+0x{BREAK_AT - 1}"
    return f"{first} {after}+0x{STEPS - BREAK_AT}"


def rising(each: float) -> str:
    return f"0+{each:g}x{STEPS}"


def healthy() -> Series:
    """Every series of a gateway that drives well, as a scrape shows it."""
    series = {name("up"): constant(1)}
    for (metric, labels), value in Program(active(tuning=TUNED)).run(1000).scrape().samples.items():
        series[name(metric, **dict(labels))] = constant(value)
    ticks = round(EVERY_S / 0.05)
    series[gateway("ticks_total")] = rising(ticks)
    series |= lateness(ticks, 0)
    return series


def lateness(early: int, late: int) -> Series:
    """So many ticks between two scrapes 0.1 ms late, and so many 20 ms."""
    bounds = ("5e-05", "0.0001", "0.0002", "0.0005", "0.001", "0.002", "0.005", "0.01")
    bucket = "tick_lateness_seconds_bucket"
    found = {gateway(bucket, le=bound): rising(early) for bound in bounds[1:]}
    return found | {
        gateway(bucket, le="5e-05"): rising(0),
        gateway(bucket, le="0.025"): rising(early + late),
        gateway(bucket, le="+Inf"): rising(early + late),
    }


STARTING_AGAIN = " ".join(f"{starts}+0x14" for starts in range(1, 11))
FIRES: dict[str, tuple[Series, set[str]]] = {
    "VcuGatewayDown": ({gateway("up"): step("1", "0")}, set()),
    "VcuGatewayExporterDown": ({name("up"): step("1", "0")}, set()),
    "VcuGatewayFaultLatched": ({gateway("fault_latched", fault_class="driver"): step()}, set()),
    "VcuGatewayStopNotObeyed": ({gateway("stop_stage", stage="not obeyed"): step()}, set()),
    "VcuGatewayStopNotConfirmed": ({gateway("stop_stage", stage="on the bus"): step()}, set()),
    "VcuGatewayControllerDisobeys": ({cause("echo_direction", "stop"): step("_")}, set()),
    "VcuGatewaySpeedImplausible": ({cause("speed_step", "alarm"): step("_")}, set()),
    "VcuGatewayCurveInputUnknown": (
        {gateway("curve_input_known", curve=MOTOR): step("1", "0")},
        set(),
    ),
    "VcuGatewayMotorTemperaturesDiffer": (
        {cause("motor_temperature_difference", "alarm"): step("_")},
        set(),
    ),
    "VcuGatewayDriveModeWaits": ({gateway("drive_mode_waits", mode="sport"): step()}, set()),
    "VcuGatewayForeignSender": (
        {gateway("frames_foreign_total", controller="PCU1"): step()},
        set(),
    ),
    "VcuGatewayGateBlocked": ({gateway("frames_blocked_total", rule="unarmed"): step("_")}, set()),
    "VcuGatewayReceiverBug": ({gateway("receiver_bugs_total"): step()}, set()),
    "VcuGatewayNotTicking": ({gateway("ticks_total"): rising(50)}, set()),
    "VcuGatewayTicksSkipped": ({gateway("ticks_skipped_total"): step()}, set()),
    "VcuGatewayTicksLate": (lateness(97, 3), set()),
    "VcuGatewayLinkDown": (
        {
            gateway("link_state", state="up"): step("1", "0"),
            gateway("link_state", state="bus off"): step(),
        },
        set(),
    ),
    "VcuGatewayLinkErrors": ({gateway("link_state", state="error passive"): step()}, set()),
    "VcuGatewayFramesDropped": ({gateway("frames_dropped_total"): step()}, set()),
    "VcuGatewayFramesUnjudged": ({gateway("frames_unjudged_total"): step()}, set()),
    "VcuGatewayFramesUnsent": ({gateway("frames_unsent_total", reason="late"): step()}, set()),
    "VcuGatewayMessageStale": ({gateway("message_stale", message="BMS_Status"): step()}, set()),
    "VcuGatewayRestarted": ({gateway("starts_total"): step("1", "2")}, set()),
    "VcuGatewayRestartLoop": ({gateway("starts_total"): STARTING_AGAIN}, {"VcuGatewayRestarted"}),
    "VcuGatewayApiTurnedAway": ({gateway("api_connections_turned_away_total"): step()}, set()),
    "VcuGatewayApiCrowded": ({gateway("api_connections_gave_way_total"): step()}, set()),
    "VcuGatewayLogLinesDropped": ({gateway("log_lines_dropped_total"): step()}, set()),
    "VcuGatewayRecorderDown": ({gateway("recorder_up"): step("1", "0")}, set()),
    "VcuGatewayNotRecorded": ({gateway("recorder_connections"): step("1", "0")}, set()),
    "VcuGatewayRecorderDisk": (
        {
            gateway("recorder_disk_state", state="ok"): step("1", "0"),
            gateway("recorder_disk_state", state="full"): step(),
        },
        set(),
    ),
    "VcuGatewayRecorderSlowDisk": ({gateway("recorder_sync_seconds"): step("0.02", "1.1")}, set()),
    "VcuGatewayFramesNotRecorded": ({gateway("recorder_frames_lost_total"): step()}, set()),
}
"""What breaks, by the alert that it raises; and which others that raises too."""

QUIET: dict[str, Series] = {
    "a healthy gateway": {},
    "a reboot of the computer": {gateway("starts_total"): step("7", "1")},
    "frames unsent because the bus is closed": {
        gateway("frames_unsent_total", reason="closed"): step()
    },
    "a recorder that lets the disk have a second": {gateway("recorder_sync_seconds"): constant(1)},
    "a message that is stale for 10 s": {
        gateway("message_stale", message="BMS_Status"): f"0+0x142 1+0x1 0+0x{STEPS - 144}"
    },
    "a curve whose input is not known for 30 s": {
        gateway("curve_input_known", curve=MOTOR): f"1+0x139 0+0x5 1+0x{STEPS - 146}"
    },
    "a drive mode that waits for 30 s": {
        gateway("drive_mode_waits", mode="sport"): f"0+0x139 1+0x5 0+0x{STEPS - 146}"
    },
    "a stop that is confirmed within 10 s": {
        gateway("stop_stage", stage="on the bus"): f"0+0x142 1+0x1 0+0x{STEPS - 144}",
        gateway("stop_stage", stage="cut"): f"0+0x144 1+0x{STEPS - 145}",
    },
    "one tick in a thousand that is late": lateness(999, 1) | {gateway("ticks_total"): rising(100)},
}
"""What must wake nobody."""


@pytest.fixture(scope="module")
def promtool():
    """Runs promtool; its output where it is content, else the test fails."""
    found = os.environ.get("PROMTOOL") or shutil.which("promtool")
    path = Path(found) if found else CACHED
    if not path.exists():
        pytest.fail("no promtool here: make tools, or tests/monitoring/fetch-promtool")

    def run(*arguments: object, text: str = "") -> str:
        command = [str(path), *map(str, arguments)]
        done = subprocess.run(command, input=text, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout + done.stderr

    return run


def test_every_alert_is_tried():
    groups = yaml.safe_load(ALERTS.read_text(encoding="utf-8"))["groups"]
    assert {rule["alert"] for group in groups for rule in group["rules"]} == set(FIRES)


def test_what_is_broken_is_part_of_what_is_healthy():
    known = set(healthy()) | {
        gateway("frames_blocked_total", rule="unarmed"),  # comes with the first
        cause("echo_direction", "stop"),
        cause("speed_step", "alarm"),
        cause("motor_temperature_difference", "alarm"),
        gateway("frames_dropped_total"),  # only where the bus is a SocketCAN interface
    }
    for series in [one for one, _ in FIRES.values()] + list(QUIET.values()):
        assert set(series) <= known


def test_promtool_finds_nothing_to_complain_of_in_the_metrics(promtool):
    assert promtool("check", "metrics", text=driven().scrape().text) == ""


def test_promtool_reads_the_rules_and_the_example_of_a_configuration(promtool):
    assert f"SUCCESS: {len(FIRES)} rules found" in promtool("check", "rules", ALERTS)
    promtool("check", "config", MONITORING / "prometheus.yml")


def test_promtool_reads_every_expression_of_the_dashboard(promtool, tmp_path):
    panels = json.loads(DASHBOARD.read_text(encoding="utf-8"))["panels"]
    expressions = [target["expr"] for panel in panels for target in panel.get("targets", [])]
    rules = [
        {"record": f"shown_{number}", "expr": expression.replace("$__rate_interval", "1m")}
        for number, expression in enumerate(expressions)
    ]
    path = tmp_path / "dashboard.yaml"
    path.write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
    assert f"SUCCESS: {len(rules)} rules found" in promtool("check", "rules", path)


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_each_alert_fires_for_what_it_is_for_and_nothing_else_does(promtool, tmp_path):
    tests = [_unit(alert, series, {alert} | more) for alert, (series, more) in FIRES.items()]
    tests += [_unit(what, series, set()) for what, series in QUIET.items()]
    path = tmp_path / "alerts.test.yaml"
    path.write_text(
        json.dumps(
            {
                "rule_files": [str(ALERTS)],
                "evaluation_interval": f"{EVERY_S}s",
                "tests": tests,
            }
        )
    )
    promtool("test", "rules", path)


def _unit(what: str, broken: Series, firing: set[str]) -> dict[str, object]:
    """One of promtool's unit tests: the alerts that fire after twelve minutes."""
    series = healthy() | broken
    return {
        "name": what,
        "interval": f"{EVERY_S}s",
        "input_series": [{"series": one, "values": values} for one, values in series.items()],
        "promql_expr_test": [
            {
                "expr": 'group by (alertname) (ALERTS{alertstate="firing"})',
                "eval_time": f"{ASKED_AT_S}s",
                "exp_samples": [
                    {"labels": f'{{alertname="{alert}"}}', "value": 1} for alert in sorted(firing)
                ],
            }
        ],
    }
