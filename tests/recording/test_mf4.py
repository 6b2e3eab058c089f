"""asammdf: kept out of every process of the gateway, and at hand where `decode` reads MF4."""

import ast
import contextlib
import gzip
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.export_libraries import PATIENCE_S, ROOT, export_folder, with_export_libraries
from vcu_gateway.protocol import dbc, packaged

__all__ = ["export_folder"]
pytestmark = pytest.mark.timeout(PATIENCE_S)

SOURCE = ROOT / "src"
HEAVY = ("asammdf", "numpy", "pandas")
# FILE and identifiers: writes the same frames as FILE.log and FILE.mf4.
WRITE = """
import sys, can
for suffix in (".log", ".mf4"):
    with can.Logger(sys.argv[1] + suffix) as writer:
        for number, can_id in enumerate(sys.argv[2:]):
            at_s, data = 1_700_000_000 + number / 100, bytes([number] * 8)
            writer(can.Message(at_s, int(can_id), data=data, channel=0))
"""


def python(folder: Path | None, *arguments: str, timeout_s: float = 90) -> str:
    environment = dict(os.environ) if folder is None else with_export_libraries(folder)
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env=environment,
        timeout=timeout_s,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def decoded(folder: Path, path: Path) -> list[dict]:
    lines = python(folder, "-m", "vcu_gateway", "decode", str(path)).splitlines()
    frames = [json.loads(line) for line in lines]
    return [{"message": one["message"], "signals": one["signals"]} for one in frames]


@pytest.mark.ci
def test_decode_reads_mf4_where_asammdf_is_installed(export_folder, tmp_path):
    messages = dbc.load(packaged("vcu.dbc")).messages
    identifiers = [str(message.can_id) for message in messages * 3]
    python(export_folder, "-c", WRITE, str(tmp_path / "drive"), *identifiers)
    expected = decoded(export_folder, tmp_path / "drive.log")
    assert len(expected) == len(identifiers)
    recording = tmp_path / "drive.mf4"
    assert decoded(export_folder, recording) == expected
    packed = tmp_path / "drive.mf4.gz"
    packed.write_bytes(gzip.compress(recording.read_bytes()))
    assert decoded(export_folder, packed) == expected


def imports_of(path: Path) -> set[str]:
    """Every module that a module imports from, at its top or later."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return found


def modules_with_python_can() -> list[str]:
    """Every module of the program that imports python-can, or cantools, which imports it."""
    return [
        ".".join(path.relative_to(SOURCE).with_suffix("").parts)
        for path in sorted((SOURCE / "vcu_gateway").rglob("*.py"))
        if imports_of(path) & {"can", "can.io", "cantools", "vcu_gateway.python_can"}
    ]


@pytest.mark.ci
def test_there_is_something_to_keep_out(export_folder):
    loaded = "import sys, can; print(*sys.modules)"
    assert set(HEAVY) <= set(python(export_folder, "-c", loaded).split())
    assert len(modules_with_python_can()) >= 6


@pytest.mark.ci
@pytest.mark.parametrize("module", [*modules_with_python_can(), "vcu_gateway.cli.run"])
def test_whatever_module_comes_first_python_can_comes_without_asammdf(export_folder, module):
    program = f"import {module}, sys; print(*sys.modules)"
    loaded = set(python(export_folder, "-c", program).split())
    assert "can.io.mf4" in loaded
    assert not loaded & set(HEAVY)


@pytest.mark.ci
def test_asammdf_is_hidden_only_while_python_can_is_imported(export_folder):
    program = "import vcu_gateway.python_can, asammdf; print(asammdf.__name__)"
    assert python(export_folder, "-c", program).strip() == "asammdf"
    program = (
        "import asammdf, vcu_gateway.python_can, sys; print(sys.modules['asammdf'] is asammdf)"
    )
    assert python(export_folder, "-c", program).strip() == "True"


class Cost(NamedTuple):
    """What one gateway took; the memory is the most that it had."""

    cpu_s: float
    memory_kb: int


class Running(NamedTuple):
    """A gateway and what it said until its bus was open."""

    pid: int
    said: list[str]


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    path = tmp_path / "gateway.yaml"
    path.write_text("bus: {interface: virtual, channel: alone}\napi: {enabled: false}\n")
    return path


@contextlib.contextmanager
def gateway(folder: Path | None, configuration: Path, *options: str) -> Iterator[Running]:
    """A gateway that has ticked for a moment."""
    environment = dict(os.environ) if folder is None else with_export_libraries(folder)
    command = [sys.executable, *options, "-m", "vcu_gateway", "run", "-c", str(configuration)]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        said = []
        for line in process.stderr:
            said.append(line)
            if '"link_open"' in line:
                break
        time.sleep(0.2)
        try:
            yield Running(process.pid, said)
        finally:
            process.terminate()
            process.communicate()


def cost(folder: Path | None, configuration: Path) -> Cost:
    """From the start to some ticks."""
    with gateway(folder, configuration) as running:
        proc = Path(f"/proc/{running.pid}")
        ticks = (proc / "stat").read_text().rpartition(")")[2].split()[11:13]
        (memory,) = re.findall(r"^VmHWM:\s+(\d+) kB", (proc / "status").read_text(), re.MULTILINE)
    return Cost(sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK"), int(memory))


@pytest.mark.ci
def test_a_gateway_starts_with_asammdf_installed_as_without(export_folder, configuration, capsys):
    """A busy machine only adds: the least of some turns is compared, of more where it is busy."""
    without, beside = [], []
    for turn in range(1, 11):
        without.append(cost(None, configuration))
        beside.append(cost(export_folder, configuration))
        least, least_beside = (Cost(*map(min, zip(*of, strict=True))) for of in (without, beside))
        if turn >= 3 and least_beside.cpu_s <= 1.3 * least.cpu_s:
            break
    with capsys.disabled():
        print(f"\nwithout asammdf: {least}, with it: {least_beside}, after {turn} turns")
    assert least_beside.cpu_s <= 1.3 * least.cpu_s
    assert least_beside.memory_kb <= 1.1 * least.memory_kb


def test_nothing_of_asammdf_is_in_a_running_gateway(export_folder, configuration):
    with gateway(export_folder, configuration, "-X", "importtime") as running:
        mapped = Path(f"/proc/{running.pid}/maps").read_text()
    lines = [line for line in running.said if line.startswith("import time:")]
    imported = {line.rpartition("|")[2].strip() for line in lines}
    assert {"can.io.mf4", "vcu_gateway.daemon.loop"} <= imported
    assert not imported & {"asammdf.mdf", "numpy", "pandas"}  # asammdf itself was looked for
    assert ".so" in mapped
    assert str(export_folder) not in mapped
