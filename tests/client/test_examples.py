"""The programs of docs/examples, run as a person runs them."""

import csv
import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.client.fake_gateway import PATIENCE_S
from tests.client.vehicle import refused

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
PROGRAMS = sorted(EXAMPLES.glob("*.py"))
BUTTON, AXIS, INITIAL = 1, 2, 0x80
PERIOD_S = 0.02


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def start(gateway, fake):
    running = []
    fake.vehicle.demands_expire = False

    def start(name, *options, socket=gateway):
        program = subprocess.Popen(
            [sys.executable, EXAMPLES / name, "--socket", socket, *map(str, options)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        running.append(program)
        return program

    yield start
    for program in running:
        program.kill()
        program.communicate()


def outcome(program):
    stdout, stderr = program.communicate(timeout=PATIENCE_S)
    return program.returncode, stdout, stderr


def throttles(fake):
    return [demand.throttle_pct for demand in fake.demands()]


def assert_left_without_motion(fake):
    fake.wait_for(lambda: not fake.open_connections)
    assert throttles(fake)[-1] == 0
    assert "demand.release" in fake.methods()


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_every_program_explains_itself(path):
    done = subprocess.run([sys.executable, path, "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert "--socket" in done.stdout


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_every_program_is_in_the_readme(path):
    assert f"`{path.name}`" in (EXAMPLES / "README.md").read_text()


# control_loop.py


def test_the_control_loop_ramps_up_holds_and_ends_without_motion(start, fake):
    program = start("control_loop.py", "--throttle-pct", 20, "--ramp-s", 0.2, "--for-s", 1.5)
    code, _, stderr = outcome(program)
    assert code == 0, stderr
    driven = [pct for pct in throttles(fake) if pct]
    assert driven == sorted(driven)
    assert driven[-1] == 20
    assert_left_without_motion(fake)


def test_the_control_loop_ends_with_the_reason_when_the_mode_changes(start, fake):
    program = start("control_loop.py", "--for-s", 60)
    fake.wait_for(lambda: any(throttles(fake)))
    fake.vehicle.mode = "fault"
    code, _, stderr = outcome(program)
    assert code == 1
    assert "the drive ended: fault" in stderr
    assert_left_without_motion(fake)


def test_the_control_loop_waits_for_arming_and_says_why_it_cannot(start, fake):
    fake.faults.refuse["arm"] = refused("not_allowed_now", "the battery is not heard of")
    code, _, stderr = outcome(start("control_loop.py", "--patience-s", 1.5))
    assert code == 1
    assert stderr.count("not armed yet: the battery is not heard of") == 1
    assert fake.methods().count("arm") >= 2
    assert_left_without_motion(fake)


def test_the_control_loop_ends_cleanly_when_interrupted(start, fake):
    program = start("control_loop.py", "--for-s", 60)
    fake.wait_for(lambda: any(throttles(fake)))
    program.send_signal(signal.SIGINT)
    code, _, stderr = outcome(program)
    assert code == 0
    assert "Traceback" not in stderr
    assert_left_without_motion(fake)


def test_the_control_loop_ends_when_the_gateway_does(start, fake):
    program = start("control_loop.py", "--for-s", 60)
    fake.wait_for(lambda: any(throttles(fake)))
    fake.stop()
    code, _, stderr = outcome(program)
    assert code == 1
    assert "systemctl start vcu-gateway" in stderr


def test_a_missed_deadline_is_skipped_and_the_grid_kept():
    next_deadline = loaded("control_loop").next_deadline
    assert next_deadline(10.0, 10.001) == pytest.approx(10.0 + PERIOD_S)
    assert next_deadline(10.0, 10.0 + 2.5 * PERIOD_S) == pytest.approx(10.0 + 3 * PERIOD_S)
    assert next_deadline(10.0, 9.0) == pytest.approx(10.0 + PERIOD_S)


# logger.py


def test_the_logger_writes_csv_with_a_column_for_each_signal(start, tmp_path):
    path = tmp_path / "log.csv"
    options = ["--message", "BMS_Status", "--rate-hz", 50, "--count", 3, "--output", path]
    code, _, stderr = outcome(start("logger.py", *options))
    assert code == 0, stderr
    rows = list(csv.DictReader(path.open()))
    assert [row["BMS_Status.PackVoltage"] for row in rows] == ["52.1"] * 3
    assert rows[0]["mode"] == "standby"
    assert rows[0]["lost"] == "0"


def test_the_logger_writes_json_lines_to_stdout(start):
    code, stdout, _ = outcome(start("logger.py", "--format", "json", "--count", 2))
    assert code == 0
    lines = [json.loads(line) for line in stdout.splitlines()]
    assert [line["mode"] for line in lines] == ["standby", "standby"]


def test_the_logger_leaves_values_empty_that_may_not_be_relied_upon():
    good = {"value": 1.5, "quality": "good"}
    stale = {"value": 2.5, "quality": "stale"}
    messages = {"A": {"signals": {"X": good, "Y": stale}}}
    state = {"monotonic_ns": 1, "mode": "active", "messages": messages, "commands": {}}
    cells = loaded("logger")._cells(state)
    assert (cells["A.X"], cells["A.Y"]) == (1.5, None)


def test_the_logger_reports_lost_updates(start, fake):
    state = fake.vehicle.state([])
    update = {"subscription": 1, "lost": 4, "state": state}
    message = {"jsonrpc": "2.0", "method": "state.update", "params": update}
    fake.faults.say["state.update"] = json.dumps(message).encode() + b"\n"
    code, _, stderr = outcome(start("logger.py", "--rate-hz", 50, "--count", 2))
    assert code == 0
    assert "4 updates lost, 8 since the start" in stderr


def test_the_logger_outlives_the_gateway(start, fake):
    program = start("logger.py", "--rate-hz", 50, "--format", "json")
    program.stdout.readline()
    fake.restart()
    fake.wait_for(lambda: fake.methods().count("state.subscribe") == 2)
    program.send_signal(signal.SIGINT)
    code, _, stderr = outcome(program)
    assert code == 0
    assert "trying again" in stderr


def test_the_logger_ends_where_the_gateway_refuses(start):
    code, _, stderr = outcome(start("logger.py", "--message", "NO_SUCH_MESSAGE"))
    assert code == 1
    assert "NO_SUCH_MESSAGE" in stderr


# joystick.py


class Stick:
    """A pipe in place of the device; `unplug` ends it."""

    def __init__(self, path):
        os.mkfifo(path)
        self.path = path
        self._file = os.open(path, os.O_RDWR)

    def send(self, kind, number, value):
        os.write(self._file, loaded("joystick").EVENT.pack(0, value, kind, number))

    def unplug(self):
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


@pytest.fixture
def stick(tmp_path):
    stick = Stick(tmp_path / "js0")
    yield stick
    stick.unplug()


@pytest.fixture
def driving(start, stick, fake):
    """The program, armed by the stick's button."""
    program = start("joystick.py", "--device", stick.path)
    stick.send(BUTTON | INITIAL, 0, 1)
    stick.send(AXIS | INITIAL, 1, 0)
    fake.wait_for(lambda: len(fake.demands()) > 2)
    assert "arm" not in fake.methods()
    stick.send(BUTTON, 0, 1)
    stick.send(BUTTON, 0, 0)
    fake.wait_for(lambda: "arm" in fake.methods())
    return program


def test_the_stick_forward_is_throttle_and_back_is_brake(driving, stick, fake):
    stick.send(AXIS, 1, -32767)
    fake.wait_for(lambda: throttles(fake)[-1] == 30)
    stick.send(AXIS, 1, 32767)
    fake.wait_for(lambda: fake.demands()[-1].params["values"]["brake_pct"] == 100)
    assert throttles(fake)[-1] == 0


def test_the_direction_changes_with_the_stick_released_only(driving, stick, fake):
    stick.send(AXIS, 1, -32767)
    fake.wait_for(lambda: throttles(fake)[-1] == 30)
    stick.send(BUTTON, 2, 1)
    stick.send(AXIS, 1, 0)
    fake.wait_for(lambda: throttles(fake)[-1] == 0)
    assert not fake.demands()[-1].params["values"]["motor_reverse"]
    stick.send(BUTTON, 2, 1)
    fake.wait_for(lambda: fake.demands()[-1].params["values"]["motor_reverse"])


def test_a_joystick_that_vanishes_leaves_no_motion(driving, stick, fake):
    stick.send(AXIS, 1, -32767)
    fake.wait_for(lambda: throttles(fake)[-1] == 30)
    stick.unplug()
    code, _, stderr = outcome(driving)
    assert code == 1
    assert "the joystick is gone" in stderr
    assert_left_without_motion(fake)


def test_a_button_stops_the_vehicle(driving, stick, fake):
    stick.send(BUTTON, 3, 1)
    fake.wait_for(lambda: "estop" in fake.methods())


def test_a_missing_joystick_is_told(start, tmp_path):
    code, _, stderr = outcome(start("joystick.py", "--device", tmp_path / "none"))
    assert code == 1
    assert "No such file" in stderr


@pytest.mark.parametrize(
    ("position", "expected"),
    [(0, 0), (0.1, 0), (-0.1, 0), (1, 1), (-1, -1), (0.55, 0.5), (-0.55, -0.5)],
)
def test_the_dead_band_is_nothing_and_begins_without_a_step(position, expected):
    assert loaded("joystick").deflection(position, 0.1) == pytest.approx(expected)
