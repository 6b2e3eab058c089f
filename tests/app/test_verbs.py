"""The verbs that talk to a running gateway: what they print, and their exit codes."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys

import pytest

from tests.app.verbs import stage_of, vcu
from tests.driven import Driven, driven, wait_until
from tests.recorder.gateway import RecorderProcess
from vcu_gateway.api import openrpc, results
from vcu_gateway.core.commands import Command

TRIES = 8


def troubles(gateway: Driven) -> list[int]:
    """How often its mode changed or a cause began."""
    log = gateway.loop.event_log.latest(1000)
    return [one.count for one in log if one.event.name in ("mode_changed", "cause_began")]


@pytest.fixture
def ask(running: Driven):
    """A verb, asked again where the machine held the vehicle up meanwhile."""

    def asked(line: str) -> subprocess.CompletedProcess[str]:
        for _ in range(TRIES):
            running.until_ready()
            before = troubles(running)
            done = vcu(running.socket_path, *shlex.split(line))
            if troubles(running) == before:
                break
        return done

    return asked


def test_status_is_a_few_lines_for_a_person(ask):
    done = ask("status")
    assert done.returncode == 0, done.stderr
    first_words = [line.split()[0] for line in done.stdout.splitlines()]
    assert first_words == (
        [
            "mode",
            "now",
            "why",
            "demand",
            "PCU1",
            "PCU2",
            "bus",
            "frames",
            "ticks",
            "recorder",
            "program",
        ]
    )
    assert "standby" in done.stdout
    assert "now      waiting for the pedals or a program: no fresh demand" in done.stdout


def test_status_says_whether_it_is_recorded(ask, tmp_path):
    assert "recorder not connected: nothing is recorded" in ask("status").stdout
    recorder = RecorderProcess(tmp_path)
    recorder.wait_for(lambda status: status["pid"])
    with driven(tmp_path, f"recorder: {{socket_path: {recorder.socket}}}\n") as one:
        recorder.wait_for(lambda status: status["totals"]["ticks"])
        said = vcu(one.socket_path, "status").stdout
    recorder.close()
    assert re.search(r"^recorder connected, \d+ ticks handed over, 0 lost", said, re.MULTILINE)


def test_status_is_one_json_object_for_a_program(ask):
    found = json.loads(ask("status --json").stdout)
    openrpc.result_adapter(results.Why).validate_python(found["why"])
    openrpc.result_adapter(results.Health).validate_python(found["health"])


def test_status_says_what_is_known_of_a_stop(fresh):
    assert "stop " not in vcu(fresh.socket_path, "status").stdout
    fresh.nodes.vehicle.motors["PCU2"].ignores_commands = True
    fresh.nodes.vehicle.motors["PCU2"].order = Command()
    with fresh.client() as client:
        client.estop()
    fresh.until(lambda: stage_of(fresh) == "not obeyed", "its status")
    said = "stop     NOT OBEYED: PCU2 reports PowerCut normal, throttle 0.0 %; use the contactor"
    assert said in vcu(fresh.socket_path, "status").stdout.splitlines()
    found = json.loads(vcu(fresh.socket_path, "status", "--json").stdout)
    assert found["stop"]["stage"] == "not obeyed"


def test_a_check_of_the_status_has_an_exit_code(ask, fresh):
    assert ask("status --check").returncode == 0
    with fresh.client() as client:
        client.estop()
        fresh.until_mode("fault")
    assert vcu(fresh.socket_path, "status", "--check").returncode == 1


def test_why_is_one_line(ask):
    done = ask("why")
    assert done.stdout.startswith("standby; ")
    assert len(done.stdout.splitlines()) == 1


def test_events_are_a_line_each(ask):
    done = ask("events -n 3")
    assert len(done.stdout.splitlines()) == 3
    assert len(json.loads(ask("events -n 3 --json").stdout)["events"]) == 3


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("arm", 75, "error: there is no fresh demand"),
        ("reset", 75, "error: nothing is latched"),
        ("reset --level service --json", 75, "error: nothing is latched"),
        ("demand --throttle 500", 75, "error: PCU1 throttle_pct must be 0 to 100, not 500"),
        ("demand --source 'a b'", 75, "error: "),
        ("reset --level chief", 2, "'chief' is not one of 'driver', 'service'"),
        ("events -n 0", 2, "0 is not in the range"),
    ],
)
def test_a_refusal_is_a_line_and_an_exit_code(ask, line, code, words):
    done = ask(line)
    assert done.returncode == code, done
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_without_a_gateway_every_verb_says_so(tmp_path):
    for verb in ("status", "why", "demand", "arm", "disarm", "reset", "estop", "events", "reload"):
        done = vcu(tmp_path / "control.sock", verb)
        assert done.returncode == 69, verb
        assert done.stderr.startswith("error: "), verb
        assert len(done.stderr.splitlines()) == 1, done.stderr


def test_disarm_and_reload_say_what_came_of_it(ask):
    assert ask("disarm").stdout == "standby\n"
    assert ask("reload").stdout.startswith("changed: nothing (")


def test_a_refused_reload_is_a_line_for_each_reason_and_exit_78(fresh):
    fresh.configure("limits: {power_limit_max_w: -1, speed_limit_max_rpm: -1}\n")
    done = vcu(fresh.socket_path, "reload")
    assert done.returncode == 78
    assert [line.split(":")[0] for line in done.stderr.splitlines()] == ["error", "error"]


@pytest.mark.clock
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_demand_drives_while_it_runs_and_stops_with_it(running: Driven, number):
    command = [sys.executable, "-m", "vcu_gateway", "demand", "--throttle", "20", "--arm"]
    environment = {**os.environ, "VCU_GATEWAY_SOCKET": str(running.socket_path)}
    running.until_ready()
    running.throttles()
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as holder:
        wait_until(lambda: max(running.throttles(), default=0) > 40, "throttle on the bus")
        holder.send_signal(number)
        running.until_mode("standby")
        output = holder.communicate(timeout=60)[0]
    assert holder.returncode == (-9 if number == signal.SIGKILL else 0)
    assert "active; demand of " in output
    running.throttles()
    running.until(lambda: running.throttles() == {0}, "zero torque")


def test_the_completion_of_each_shell_is_printed_and_completes_verbs():
    for shell in ("bash", "zsh", "fish"):
        done = vcu("", "completion", shell)
        assert done.returncode == 0
        assert "_VCU_GATEWAY_COMPLETE" in done.stdout
    words = {"COMP_WORDS": "vcu-gateway est", "COMP_CWORD": "1"}
    environment = {**os.environ, **words, "_VCU_GATEWAY_COMPLETE": "bash_complete"}
    command = [sys.executable, "-c", "from vcu_gateway.cli import main; main()"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=90)
    assert "estop" in done.stdout


def test_a_verb_answers_in_a_moment(ask):
    """It imports the client only: no bus, no configuration, no protocol."""
    code = (
        "import sys; from vcu_gateway.cli import operator, demand; "
        "print([name for name in ('can', 'cantools', 'pydantic', 'yaml') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=90)
    assert done.stdout == "[]\n"


# Tuning.

TUNED = """
vehicle: {motor_rpm_per_kmh: 85.3}
curves: {power_limit_w: {by_motor_temperature_c: [[95, 14000], [110, 6000]]}}
drive_modes: {start: eco, modes: {eco: {power_limit_w: 8000}, sport: {},
  valet: {left_by_service: true}}}
laws: {slip: {}}
"""


def test_tuning_shows_the_drive_mode_each_curve_and_the_slip_limiter(tmp_path):
    with driven(tmp_path, TUNED) as one:
        one.until_ready()
        lines = vcu(one.socket_path, "tuning").stdout.splitlines()
        found = json.loads(vcu(one.socket_path, "tuning", "--json").stdout)
    assert lines[0] == "drive mode eco (others: sport, valet)"
    assert re.fullmatch(r"power_limit_w.by_motor_temperature_c +\d+ °C +14000 W *", lines[2]), lines
    assert lines[3] == "slip: throttle at most PCU1 100 %, PCU2 100 %"
    openrpc.result_adapter(results.TuningNow).validate_python(found)


def test_without_tuning_both_verbs_say_so(ask):
    assert ask("tuning").stdout.startswith(
        "no curve, drive mode, slip limiter or pedal is configured"
    )
    assert ask("drive-mode").stdout.startswith("no drive mode is configured")
    refused = ask("drive-mode sport")
    assert refused.returncode == os.EX_TEMPFAIL
    assert refused.stderr == "error: there is no drive mode sport; none is configured\n"


def test_a_drive_mode_is_taken_refused_and_left_at_service_level(tmp_path):
    with driven(tmp_path, TUNED) as one:
        one.until_ready()
        path = one.socket_path
        assert vcu(path, "drive-mode", "sport").stdout == "sport (others: eco, valet)\n"
        assert vcu(path, "drive-mode").stdout == "sport (others: eco, valet)\n"
        wrong = vcu(path, "drive-mode", "sprot")
        assert wrong.stderr == (
            "error: there is no drive mode sprot; the modes are eco, sport, valet\n"
        )
        vcu(path, "drive-mode", "valet")
        kept = vcu(path, "drive-mode", "eco")
        assert kept.stderr == "error: drive mode valet is left at service level\n"
        left = vcu(path, "drive-mode", "eco", "--level", "service")
        assert left.stdout == "eco (others: sport, valet)\n"


@pytest.mark.clock  # it needs a gateway that drives
def test_a_drive_mode_that_waits_says_for_what_and_what_counts_until_then(tmp_path):
    with driven(tmp_path, TUNED) as one, one.client() as client:
        one.until_ready()
        with client.demand("test", hold_s=None) as demand:
            client.arm()
            demand.set(throttle_pct=30.0)
            one.until(lambda: max(one.throttles(), default=0) > 20, "throttle")
            done = vcu(one.socket_path, "drive-mode", "sport")
            found = json.loads(vcu(one.socket_path, "drive-mode", "sport", "--json").stdout)
    assert done.stdout == (
        "eco; sport waits for the pedal's release, and until then of both modes' limits the lower"
        " ones count (others: sport, valet)\n"
    )
    assert (found["current"], found["requested"]) == ("eco", "sport")
