"""docs/install.md, and the commands of docs/operations.md: run in their own words.

What needs root, a unit or a real bus is run by tests/service, in the lab.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from tests.docs.pages import (
    INSTALL,
    OPERATIONS,
    PAGES,
    RECORDINGS,
    ROOT,
    SECURITY,
    blocks,
    codes,
    command_lines,
    directives,
    mentioned,
    rows,
    section,
    text,
    words,
)
from tests.driven import Driven
from tests.packaging.built import RELEASES
from vcu_gateway import cli

pytestmark = pytest.mark.timeout(400)  # a trial may be begun again

NETWORK = ROOT / "systemd"
READING = ("status", "why", "events", "version", "check-config", "doctor", "reload")
LINES = [
    (page.name, line) for page in (*PAGES, SECURITY, RECORDINGS) for line in command_lines(page)
]
READ_LINES = [line for _, line in LINES if words(line)[0] in READING]
SOCKETS = re.compile(r"/run/vcu-gateway\S*/control\.sock")
FILES = re.compile(r"/etc/vcu-gateway/\S+\.yaml")
# What matters here is what the commands say, and not how busy this machine is.
PATIENT = "freshness: {stale_after_ms: {PCU1_Status2: 400, PCU2_Status2: 400, BMS_Status: 3200}}\n"
PATIENT_DEMAND = ["--ttl-ms", "1000"]


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    """A gateway with a healthy vehicle, in standby."""
    one = Driven(tmp_path_factory.mktemp("driven"), PATIENT)
    one.start()
    with contextlib.ExitStack() as stack:
        stack.callback(one.end)
        one.until_mode("standby")
        yield one


def started(driven: Driven, line: str) -> subprocess.Popen[str]:
    """A line of a page, asked of this gateway and its file instead of the installed one."""
    line = FILES.sub(str(driven.file), SOCKETS.sub(str(driven.socket_path), line))
    arguments = words(line)
    if arguments[0] in ("check-config", "doctor") and "-c" not in arguments:
        arguments += ["-c", str(driven.file)]
    if arguments[0] == "demand":
        arguments += PATIENT_DEMAND
    return subprocess.Popen(
        [sys.executable, "-m", "vcu_gateway", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "VCU_GATEWAY_SOCKET": str(driven.socket_path)},
    )


@contextlib.contextmanager
def doing(driven: Driven, line: str) -> Iterator[subprocess.Popen[str]]:
    """A line that goes on; it is ended with the block, also where that fails."""
    with started(driven, line) as process:
        try:
            yield process
        except BaseException:
            process.kill()
            raise


def says(driven: Driven, line: str, code: int = 0) -> str:
    with doing(driven, line) as process:
        said, _ = process.communicate(timeout=60)
    assert process.returncode == code, said
    return said


def parsed(line: str) -> None:
    """UsageError where the program has no such verb, option or value."""
    verb, *arguments = words(line)
    command = cli.group.get_command(click.Context(cli.group), verb)
    assert command is not None, line
    if isinstance(command, click.Group):
        verb, *arguments = arguments
        command = command.commands[verb]
    command.make_context(verb, [one.replace("NAME", "a") for one in arguments])


@pytest.mark.parametrize(("page", "line"), LINES)
def test_a_command_of_the_pages_is_one_of_the_program(page, line):
    parsed(line)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_so_is_one_in_the_running_text(page):
    lines = set(mentioned(page))
    assert len(lines) >= 8
    for line in lines - {"vcu-gateway run -c"}:
        parsed(line)


def test_both_pages_have_commands_that_are_run_here():
    assert len(READ_LINES) >= 12
    assert {words(line)[0] for line in READ_LINES} == set(READING) - {"reload"}


@pytest.mark.ci
@pytest.mark.parametrize("line", sorted(set(READ_LINES)))
def test_a_command_that_reads_answers(driven, line):
    allowed = {0, 1} if words(line)[0] == "doctor" else {0}  # 1: this machine is no vehicle's
    with doing(driven, line) as process:
        said, _ = process.communicate(timeout=60)
    assert process.returncode in allowed, said
    assert said.strip()


def first_arming() -> tuple[str, list[str], str]:
    """Its lines: who holds the pedals, what is said meanwhile, and the first turn."""
    of_section = [
        block for block in blocks(INSTALL, "sh") if "--throttle" in block or "arm\n" in block
    ]
    pedals, meanwhile, turn = of_section[:3]
    return pedals.strip(), meanwhile.strip().splitlines(), turn.strip()


def headline(driven: Driven) -> str:
    assert driven.loop.latest is not None
    return driven.loop.latest.why.headline()


def throttles(driven: Driven) -> set[float]:
    latest = driven.loop.latest
    assert latest is not None
    return {command.throttle_pct for command in latest.result.commands.values()}


def ready(driven: Driven) -> None:
    driven.until_mode("standby")
    driven.until(lambda: headline(driven).startswith("standby; before arming: there is"), "ready")


def status_lines() -> list[str]:
    return [codes(row[0])[0] for row in rows(section(INSTALL, "## 7. Start"))]


@pytest.mark.clock
def test_the_first_arming_goes_as_the_page_says(driven):
    pedals, meanwhile, turn = first_arming()
    ready(driven)
    assert headline(driven) in status_lines()
    with doing(driven, pedals) as holder:
        driven.until(lambda: headline(driven) == "standby; arm", "somebody holds the pedals")
        assert headline(driven) in status_lines()
        arm, why, disarm = meanwhile
        assert says(driven, arm) == "active\n"
        told = says(driven, why)
        assert re.fullmatch(r"active; .*demand of \S+ \d+ ms old; drive; disarm to end\n", told)
        assert headline(driven) in status_lines()
        assert says(driven, disarm) == "standby\n"
        holder.send_signal(signal.SIGINT)
    assert holder.returncode == 0
    ready(driven)
    with doing(driven, turn) as driver:
        driven.until(lambda: throttles(driven) == {5.0}, "5 % at both controllers")
    assert driver.returncode == 0
    driven.until(lambda: throttles(driven) == {0.0}, "released")
    driven.until_mode("standby")


@contextlib.contextmanager
def turning(driven: Driven) -> Iterator[subprocess.Popen[str]]:
    """As for the trials: 5 %, for longer."""
    ready(driven)
    with doing(driven, first_arming()[2].replace("--for 3", "--for 30")) as driver:
        driven.until(lambda: throttles(driven) == {5.0}, "5 % at both controllers")
        yield driver
        driver.kill()


@pytest.mark.clock
def test_ctrl_c_releases_the_throttle(driven):
    with turning(driven) as driver:
        driver.send_signal(signal.SIGINT)
        assert driver.wait(60) == 0
        driven.until(lambda: throttles(driven) == {0.0}, "released")
        driven.until_mode("standby")


@pytest.mark.clock
def test_the_trial_of_the_emergency_stop_goes_as_the_page_says(driven):
    with turning(driven):
        says(driven, "vcu-gateway estop")
        driven.until_mode("fault")
        shown = says(driven, "vcu-gateway why")
        told = next(
            code for code in codes(text(INSTALL)) if code.startswith("fault; latched (service)")
        )
        assert shown.startswith(told)
        frames = driven.loop.latest.result.frames
        assert {frame.data[0] for frame in frames} == {0x8C}
        assert "service level" in says(driven, "vcu-gateway reset", 75)
    driven.until(lambda: "first:" not in headline(driven), "nothing stands against a reset")
    assert says(driven, "vcu-gateway reset --level service") == "starting\n"
    driven.until_mode("standby")


@pytest.mark.ci
def test_a_checked_configuration_says_what_the_page_says(driven):
    assert "valid" in says(driven, "vcu-gateway check-config")
    assert "no static demand" in says(driven, "vcu-gateway check-config")


@pytest.mark.parametrize("number", [0, 1])
def test_a_configuration_of_the_page_is_valid(tmp_path, number):
    path = tmp_path / "gateway.yaml"
    path.write_text(blocks(INSTALL, "yaml")[number])
    command = [sys.executable, "-m", "vcu_gateway", "check-config", "--other-machine"]
    done = subprocess.run([*command, "-c", str(path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("page", [*PAGES, SECURITY, RECORDINGS], ids=lambda page: page.name)
def test_every_block_is_shell(page):
    for block in blocks(page, "sh"):
        done = subprocess.run(["bash", "-n"], input=block, capture_output=True, text=True)
        assert done.returncode == 0, f"{block}\n{done.stderr}"


# The interface, the files.


def test_the_interface_is_set_up_by_hand_as_the_shipped_files_do():
    (by_hand,) = (block for block in blocks(INSTALL, "sh") if "sample-point" in block)
    network, link = directives(NETWORK / "can0.network"), directives(NETWORK / "10-can0.link")
    (bit_rate,), (point,), (restart,) = (
        network[name] for name in ("BitRate", "SamplePoint", "RestartSec")
    )
    (queue,) = link["TransmitQueueLength"]
    assert f"bitrate {bit_rate.replace('K', '000')} " in by_hand
    assert f"sample-point {float(point.rstrip('%')) / 100:g} " in by_hand
    assert f"restart-ms {restart.removesuffix('ms')}\n" in by_hand
    assert f"txqueuelen {queue}\n" in by_hand
    for block in blocks(INSTALL, "sh"):
        assert set(re.findall(r"txqueuelen (\d+)", block)) <= {queue}


def shipped() -> set[str]:
    """What the package puts below /usr/share/vcu-gateway, as its list of files has it."""
    listed = (ROOT / "packaging" / "debian" / "vcu-gateway.install").read_text().splitlines()
    pairs = [line.split() for line in listed if line.strip()]
    found = set()
    for source, folder in pairs:
        path = ROOT / source
        inside = path.rglob("*") if path.is_dir() else []
        top = f"/{folder}/{Path(source).name}"
        found |= {top, f"/{folder}"}
        found |= {f"{top}/{one.relative_to(path)}" for one in inside}
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_shipped_file_that_a_page_names_is_in_the_package(page):
    named = set(re.findall(r"/usr/share/vcu-gateway/[\w./-]*\w", text(page)))
    assert named - shipped() == set()


def test_the_files_of_the_source_tree_that_the_page_installs_are_there():
    (block,) = (block for block in blocks(INSTALL, "sh") if "systemd/sysusers.conf" in block)
    named = re.findall(r"\b((?:systemd|config)/\S+|requirements\.lock)", block)
    named = [name for name in named if not name.endswith("/")]
    assert len(named) == 12
    for name in named:
        assert (ROOT / name).is_file(), name


def test_the_releases_of_the_pages_are_those_that_the_package_is_tested_on():
    of_the_makefile = re.search(r"^SUITES := (.*)$", text(ROOT / "Makefile"), re.MULTILINE)
    assert of_the_makefile
    assert of_the_makefile[1].split() == list(RELEASES)
    for suite, release in RELEASES.items():
        assert f"Debian {release.number} (Python {release.python})" in text(INSTALL)
        assert f"`~deb{release.number}u1`" in text(INSTALL)
        assert f"`make deb SUITE={suite}`" in text(INSTALL)
        assert f"Debian {release.number}" in text(ROOT / "README.md")


def test_every_path_that_a_unit_needs_is_in_the_table_of_places():
    places = " ".join(codes(section(INSTALL, "## What lies where")))
    for name in (
        "vcu-gateway.service",
        "vcu-gateway@.service",
        "vcu-gateway-exporter.service",
        "vcu-gateway-recorder.service",
        "vcu-gateway-recorder.socket",
        "vcu-gateway-web.service",
        "vcu-gateway-pedals.service",
    ):
        unit = (ROOT / "systemd" / name).read_text().replace("%i", "can1")
        for found in re.findall(r"(?<=[= :])/(?:etc|run|var/lib|usr/lib)/vcu-gateway[\w-]*", unit):
            assert found in places, found


def test_the_commands_of_three_in_the_morning_come_first():
    first = blocks(OPERATIONS, "sh")[0].splitlines()
    assert len(first) == 5
    assert text(OPERATIONS).index("```sh") < 400
