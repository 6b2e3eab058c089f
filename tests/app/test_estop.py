"""`vcu-gateway estop`: what it says of the stop, and its exit code."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from tests.app.verbs import stage_of, vcu
from tests.client.scripted_gateway import Scripted
from tests.driven import Driven
from vcu_gateway.api import openrpc, results

GRANTED = "Stop granted; it ends with: vcu-gateway reset --level service"
CUT = "Power is cut: PCU1 and PCU2 confirm"
NOT_OBEYED = "NOT OBEYED: PCU1 reports PowerCut normal, throttle 0.0 %; use the contactor"
OLDER = "Stop granted; this gateway is older and does not tell whether the controllers confirm"
NONE_LATCHED = "Stop granted; none is latched now"
BOTH_SILENT = "Stop sent; PCU1 and PCU2 do not confirm"


def ignoring(gateway: Driven) -> None:
    """Controller 1 ignores commands, and a stop is latched that it does not obey."""
    gateway.nodes.vehicle.motors["PCU1"].order = gateway.nodes.vehicle.motors["PCU2"].order
    gateway.nodes.vehicle.motors["PCU1"].ignores_commands = True
    with gateway.client() as client:
        client.estop()
    gateway.until(lambda: stage_of(gateway) == "not obeyed", "a controller that disobeys")


def test_it_says_each_stage_and_ends_with_0_once_both_have_cut(fresh):
    done = vcu(fresh.socket_path, "estop", "--wait", "60")
    first, *said = done.stdout.splitlines()
    assert (done.returncode, first, said[-1]) == (0, GRANTED, CUT)
    assert "Stop on the bus; waiting for PCU1 and PCU2 to confirm" in said
    assert len(said) == len(set(said))
    assert NONE_LATCHED not in said


def test_a_controller_that_does_not_obey_is_named_and_is_exit_code_1(fresh):
    ignoring(fresh)
    done = vcu(fresh.socket_path, "estop", "--wait", "0")
    assert (done.returncode, done.stdout.splitlines()) == (1, [GRANTED, NOT_OBEYED])


def test_ctrl_c_ends_the_waiting_and_not_the_stop(fresh):
    ignoring(fresh)
    command = [sys.executable, "-m", "vcu_gateway", "estop", "--wait", "600"]
    environment = {**os.environ, "VCU_GATEWAY_SOCKET": str(fresh.socket_path)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as asking:
        assert asking.stdout is not None
        assert asking.stdout.readline() == f"{GRANTED}\n"
        asking.stdout.readline()
        asking.send_signal(signal.SIGINT)
        assert asking.wait(60) == 128 + signal.SIGINT
    assert stage_of(fresh) == "not obeyed"


def test_without_waiting_it_says_that_it_was_granted(fresh):
    done = vcu(fresh.socket_path, "estop", "--no-wait")
    assert (done.returncode, done.stdout) == (0, f"{GRANTED}\n")
    fresh.until_mode("fault")


def test_as_json_it_is_one_object_with_the_stop(fresh):
    done = vcu(fresh.socket_path, "estop", "--json", "--wait", "60")
    answer = json.loads(done.stdout)
    assert answer["granted"] is True
    openrpc.result_adapter(results.StopState).validate_python(answer["stop"])
    assert answer["stop"]["stage"] == "cut"


class Answering(Scripted):
    """A gateway that grants the stop, then gives these states, the last one again and again."""

    def __init__(self, path: Path, *states: dict[str, Any]) -> None:
        super().__init__(path)
        self._states = list(states)
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        self.grant()
        while True:
            try:
                request = self.read()
            except (OSError, ValueError):
                return
            state = self._states.pop(0) if self._states[1:] else self._states[0]
            answer = {"jsonrpc": "2.0", "id": request["id"], "result": state}
            self.connection.sendall(json.dumps(answer).encode() + b"\n")


def at(stage: str, sentence: str) -> dict[str, Any]:
    return {"stop": {"stage": stage, "sentence": sentence}}


@pytest.mark.parametrize(
    ("states", "wait_s", "code", "said"),
    [
        ([at("cut", CUT)], 60, 0, [CUT]),
        ([at("not obeyed", NOT_OBEYED)], 0, 1, [NOT_OBEYED]),
        ([at("on the bus", BOTH_SILENT)], 0, 75, [BOTH_SILENT]),
        ([at("sent", "not seen")], 0, 75, ["not seen"]),
        ([at("latched", "not sent")], 0, 75, ["not sent"]),
        ([{"stop": None}], 0, 75, [NONE_LATCHED]),
        ([{"stop": None}, at("cut", CUT)], 60, 0, [CUT]),
        (
            [at("sent", "1"), at("sent", "1"), at("sent", "2"), at("cut", CUT)],
            60,
            0,
            ["1", "2", CUT],
        ),
        ([at("not obeyed", NOT_OBEYED), at("cut", CUT)], 60, 0, [NOT_OBEYED, CUT]),
        ([at("cut", CUT), at("not obeyed", NOT_OBEYED)], 60, 0, [CUT]),
        ([{"mode": "fault"}], 60, 75, [OLDER]),
    ],
    ids=[
        *("cut", "not obeyed", "not confirmed", "not seen", "not sent", "not latched"),
        *("latched later", "each change once", "cut later", "cut ends it", "an older gateway"),
    ],
)
def test_its_exit_code_is_0_only_where_the_power_is_cut(tmp_path, states, wait_s, code, said):
    with Answering(tmp_path / "control.sock", *states) as gateway:
        done = vcu(gateway.path, "estop", "--wait", str(wait_s))
    assert done.stdout.splitlines() == [GRANTED, *said]
    assert done.returncode == code
    assert done.stderr == ""
