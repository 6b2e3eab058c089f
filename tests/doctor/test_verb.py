"""`vcu-gateway doctor` as a person and as a program meet it."""

import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from vcu_gateway.doctor import checks, interface
from vcu_gateway.doctor.check_result import CheckResult, CheckStatus

ROOT = Path(__file__).parents[2]
SUBJECTS = [
    *("configuration", "protocol", "interface", "time", "permissions", "buffers", "process"),
    *("service", "libraries", "gateway"),
]
LINE = re.compile(r"(ok|warning|wrong|unknown) +([a-z]+)  .+")


def doctor(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vcu_gateway", "doctor", *arguments]
    env = {**os.environ, **environment}
    return subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=ROOT, env=env)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Of a gateway that needs no CAN: nothing is wrong with it on any machine."""
    file = tmp_path / "gateway.yaml"
    file.write_text(
        "bus: {interface: udp_multicast, channel: 239.74.163.2}\n"
        f"api: {{socket_path: {tmp_path / 'control.sock'}}}\n"
    )
    return file


def test_every_subject_has_aligned_lines_and_the_last_counts_them(config):
    done = doctor("-c", str(config))
    *lines, summary = done.stdout.splitlines()
    assert done.stderr == ""
    found = [LINE.fullmatch(line) for line in lines]
    assert all(found), lines
    assert list(dict.fromkeys(one[2] for one in found)) == SUBJECTS
    assert len({re.match(r"\w+ +\w+ +", line).end() for line in lines}) == 1
    assert sum(map(int, re.findall(r"\d+", summary))) == len(lines)


def test_nothing_wrong_is_exit_0_warnings_or_not(config):
    config.write_text(config.read_text() + "bench: {demand: {bench_use_only: true}}\n")
    done = doctor("-c", str(config))
    assert "warning  configuration" in done.stdout
    assert "\nwrong" not in done.stdout
    assert done.returncode == 0


def test_something_wrong_is_exit_1_and_the_rest_is_looked_at_all_the_same(config):
    config.write_text("bus: {interface: udp_multicast, channel: nowhere}\n")
    done = doctor("-c", str(config))
    assert done.returncode == 1
    assert f"wrong    configuration  {config}:1: bus.channel" in done.stdout
    assert "ok       service" in done.stdout
    assert "  interface  " not in done.stdout  # nobody knows which one is meant


def test_json_is_one_object_of_the_documented_shape(config):
    done = doctor("-c", str(config), "--json")
    told = json.loads(done.stdout)
    assert set(told) == {"healthy", "counts", "findings"}
    assert told["healthy"] is True
    assert list(told["counts"]) == ["ok", "warning", "wrong", "unknown"]
    assert sum(told["counts"].values()) == len(told["findings"])
    for finding in told["findings"]:
        assert list(finding) == ["subject", "check", "kind", "what", "remedy"]
        assert all(isinstance(value, str) for value in finding.values())


@pytest.mark.ci
def test_there_is_no_colour_but_on_a_terminal(config):
    assert "\x1b" not in doctor("-c", str(config)).stdout
    assert b"\x1b[32mok" in on_a_terminal(config)
    assert b"\x1b" not in on_a_terminal(config, NO_COLOR="1")


def on_a_terminal(config: Path, **environment: str) -> bytes:
    master, slave = pty.openpty()
    command = [sys.executable, "-m", "vcu_gateway", "doctor", "-c", str(config)]
    plain = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    env = {**plain, **environment}
    with subprocess.Popen(command, stdout=slave, stderr=slave, env=env, cwd=ROOT) as child:
        os.close(slave)
        shown = b""
        while chunk := _read(master):
            shown += chunk
        child.wait(60)
    os.close(master)
    return shown


def _read(master: int) -> bytes:
    try:
        return os.read(master, 65_536)
    except OSError:  # how a terminal ends
        return b""


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone can become another user")
def test_a_user_without_any_right_gets_every_line_and_no_error(config):
    os.chmod(config, 0o600)
    program = (  # imported before: the interpreter itself may be root's alone
        "import difflib, os; from vcu_gateway import cli; import vcu_gateway.cli.doctor;"
        "import vcu_gateway.config.checks;"
        "os.setgroups([]); os.setgid(65534); os.setuid(65534); cli.main()"
    )
    command = [sys.executable, "-c", program, "doctor", "-c", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd="/")
    assert done.stderr == ""
    assert "please report" not in done.stdout
    assert "unknown  configuration" in done.stdout
    assert done.stdout.splitlines()[-1].endswith("; sudo vcu-gateway doctor checks more")


def test_python_can_is_imported_for_the_dbc_alone(config):
    program = (
        "import sys; import vcu_gateway.cli.doctor; from vcu_gateway.doctor import bus_traffic;"
        "print(sorted({'can', 'cantools', 'structlog', 'asyncio'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr


def test_a_room_that_breaks_is_unknown_and_hides_no_other(config, monkeypatch):
    def broken(*_: object) -> list[CheckResult]:
        raise KeyError("never thought of")

    monkeypatch.setattr(interface, "can_socket_error", broken)
    config.write_text("bus: {channel: can0}\n")
    findings = list(checks.run_checks(config))
    found = next(one for one in findings if one.subject == "interface")
    assert (found.check, found.kind) == ("examination", CheckStatus.UNKNOWN)
    assert "KeyError" in found.what
    assert findings[-1].subject == "gateway"


@pytest.mark.parametrize("listen", [False, True])
def test_an_interface_that_is_not_there_is_wrong_and_unknown_to_listen_to(config, listen):
    config.write_text("bus: {interface: socketcan, channel: nocan9}\n")
    found = list(checks.run_checks(config, listen=listen))
    (wrong,) = [one for one in found if one.kind is CheckStatus.WRONG]
    assert wrong.subject == "interface"
    listened = [one for one in found if one.subject == "bus"]
    assert len(listened) == listen
    for one in listened:
        assert (one.check, one.kind) == ("listen", CheckStatus.UNKNOWN)
        assert one.what.startswith("cannot listen on nocan9: ")


def test_a_socket_that_answers_nonsense_is_unknown(config):
    program = (
        "import json, socket, sys; s = socket.socket(socket.AF_UNIX); s.bind(sys.argv[1])\n"
        "s.listen(); print('ready', flush=True)\n"
        "while True:\n"
        "    c, _ = s.accept()\n"
        "    for line in c.makefile():\n"
        "        reply = {'jsonrpc': '2.0', 'id': json.loads(line)['id'], 'result': {}}\n"
        "        c.sendall(json.dumps(reply).encode() + b'\\n')\n"
    )
    command = [sys.executable, "-c", program, str(config.parent / "control.sock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as nonsense:
        try:
            assert nonsense.stdout.readline() == "ready\n"
            told = told_in_time(config)
        finally:
            nonsense.kill()
    last = told["findings"][-1]
    assert (last["subject"], last["kind"]) == ("gateway", "unknown")
    assert told["healthy"] is True


def told_in_time(config: Path, attempts: int = 10) -> dict[str, Any]:
    """Asked again where the answer did not come within half a second: a machine may stall."""
    for _ in range(attempts):
        told = json.loads(doctor("-c", str(config), "--json").stdout)
        if "no gateway runs" not in told["findings"][-1]["what"]:
            break
    return told


def test_nothing_is_written_beside_the_configuration(config):
    before = sorted(config.parent.iterdir())
    doctor("-c", str(config))
    assert sorted(config.parent.iterdir()) == before
