"""The command line as a newcomer meets it, and the README's promises."""

import json
import os
import platform
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from click import Context
from click.testing import CliRunner

from vcu_gateway import __version__
from vcu_gateway.cli import group
from vcu_gateway.config import digest, load

ROOT = Path(__file__).parents[2]
VERBS = group.list_commands(Context(group))


def vcu(*arguments: str, timeout_s: float = 90) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vcu_gateway", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, cwd=ROOT)


def test_the_help_names_every_verb_and_the_exit_codes():
    done = vcu("--help")
    assert done.returncode == 0
    for verb in VERBS:
        assert re.search(rf"^  {verb}  +\w", done.stdout, re.MULTILINE), verb
    assert re.search(r"78 wrong\s+configuration", done.stdout)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_itself(verb):
    done = CliRunner().invoke(group, [verb, "--help"], prog_name="vcu-gateway")
    assert done.exit_code == 0, done.output
    assert done.output.startswith(f"Usage: vcu-gateway {verb} ")
    assert len(done.output.splitlines()) >= 5


def test_a_wrong_verb_or_option_is_exit_2_with_a_hint():
    assert vcu("fly").returncode == 2
    done = vcu("run", "--confg", "x")
    assert done.returncode == 2
    assert "--config" in done.stderr


def test_a_broken_configuration_is_exit_78_and_one_line_an_error(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text("bus:\n  chanel: can0\n  reopen_ms: 1\n")
    done = vcu("run", "-c", str(path))
    assert done.returncode == 78
    assert done.stdout == ""
    first, second = done.stderr.splitlines()
    assert first == f'error: {path}:2: bus.chanel: unknown key; did you mean "channel"?'
    assert second.startswith(f"error: {path}:3: bus.reopen_ms: must be at least 50 ms, not 1")


def test_the_gateway_runs_on_the_virtual_bus_and_writes_its_state(tmp_path):
    config, state = tmp_path / "gateway.yaml", tmp_path / "state.json"
    api = f"api: {{socket_path: {tmp_path / 'control.sock'}}}"
    config.write_text(f"bus: {{interface: virtual, channel: alone}}\n{api}\n")
    done = vcu("run", "-c", str(config), "--duration", "1.5", "--state-out", str(state))
    assert done.returncode == 0, done.stderr
    found = json.loads(state.read_text())
    ticks, late = found["ticks"], found["bus"]["refused"].get("late", 0)
    # Where the machine held frames of the end up, another tick takes their place.
    assert ticks["done"] - late <= 33 <= ticks["done"] + ticks["skipped"]
    assert found["bus"]["sent"] == 2 * (ticks["done"] - ticks["silent"]) - late
    assert found["messages"]["BMS_Status"]["signals"]["SOC"]["quality"] == "never"
    events = [json.loads(line)["event"] for line in done.stderr.splitlines()]
    assert events[:3] == ["started", "api_open", "link_open"]
    assert events[-1] == "stopped"
    assert not (tmp_path / "control.sock").exists()


@pytest.mark.parametrize("form", ["json", "console"])
def test_the_first_line_of_the_log_says_what_runs_on_what(tmp_path, form):
    path = tmp_path / "gateway.yaml"
    path.write_text(
        f"bus: {{interface: virtual, channel: alone}}\nlog: {{format: {form}}}\n"
        "api: {enabled: false}\n"
    )
    done = vcu("run", "-c", os.path.relpath(path, ROOT), "--duration", "0.1")
    assert done.returncode == 0, done.stderr
    facts = {
        "version": __version__,
        "config_file": str(path),
        "config_digest": digest(load(path)),
        "interface": "virtual",
        "channel": "alone",
        "python": platform.python_version(),
        "kernel": f"Linux {os.uname().release}",
    }
    first = done.stderr.splitlines()[0]
    if form == "json":
        found = json.loads(first)
        assert found.pop("timestamp").endswith("Z")
        assert found == {"event": "started", "level": "info", **facts}
    else:
        assert re.search(r"\[info *\] started ", first)
        for name, value in facts.items():
            assert re.search(rf"\b{name}='?{re.escape(value)}'?( |$)", first), name


def test_without_a_socket_the_gateway_drives_on_and_says_what_to_do(tmp_path):
    config = tmp_path / "gateway.yaml"
    socket = tmp_path / "nowhere" / "control.sock"
    config.write_text(
        f"bus: {{interface: virtual, channel: alone}}\napi: {{socket_path: {socket}}}\n"
    )
    done = vcu("run", "-c", str(config), "--duration", "0.2")
    assert done.returncode == 0
    found = json.loads(done.stderr.splitlines()[1])
    assert found["event"] == "api_unavailable"
    assert str(socket.parent) in found["reason"]


def test_an_account_that_does_not_exist_is_refused_at_the_start(tmp_path):
    config = tmp_path / "gateway.yaml"
    config.write_text("api:\n  operator_groups: [drivers-of-mars]\n")
    done = vcu("run", "-c", str(config), "--duration", "0.2")
    assert done.returncode == 78
    assert done.stderr.startswith(
        f"error: {config}:2: api.operator_groups: this machine has no group drivers-of-mars;"
    )


@pytest.mark.ci
@pytest.mark.clock
def test_the_demo_shows_live_values_without_hardware(tmp_path):
    done = vcu("demo", "--duration", "9", "--socket", str(tmp_path / "demo.sock"))
    assert done.returncode == 0, done.stderr
    assert "active; demand of bench" in done.stdout
    assert re.search(r"PCU1_Status2 +\d+ +[12]\d\.\d", done.stdout), "20 Hz, on a calm machine"
    assert re.search(r"MotorSpeed [1-9]\d* *\n? *rpm|MotorSpeed [1-9]", done.stdout)


def readme_commands() -> list[str]:
    """Every command of the README that needs no root, no CAN and no make."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    lines = [line for block in blocks if "vcan0" not in block for line in block.splitlines()]
    commands = [line for line in lines if line.startswith(".venv/bin/vcu-gateway")]
    return [line.removeprefix(".venv/bin/") for line in commands if RECORDED not in line]


RECORDED = "black-box"
"""The folder of the commands that need one another."""


@pytest.mark.parametrize("line", readme_commands())
def test_the_commands_of_the_readme_work_in_its_words(line, tmp_path):
    arguments = shlex.split(line.removeprefix("vcu-gateway "))
    arguments = [str(tmp_path / "out") if word == "decoded.jsonl" else word for word in arguments]
    done = vcu(*arguments)
    assert done.returncode == 0, done.stderr


def test_the_readme_has_commands_and_its_links_lead_somewhere():
    assert len(readme_commands()) >= 5
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
