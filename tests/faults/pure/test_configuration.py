"""Wrong configurations, at the start and while driving; a DBC that is another one."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.config.test_config import HEALTHY
from tests.core.simulated_drive import ZERO_TORQUE
from tests.driven import driven, wait_until
from tests.faults.conftest import ROOT, Seen
from tests.faults.machine import program
from tests.faults.pure.bystander import PATIENCE_S, bystander, once_more
from tests.faults.pure.test_process import commands, moving, next_commands
from tests.unrecorded import unrecorded
from vcu_gateway import config as configuration
from vcu_gateway.config.checks import load_protocol
from vcu_gateway.errors import ConfigError, GatewayError
from vcu_gateway.protocol import packaged


def written(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def loop(path: Path) -> Path:
    path.symlink_to(path)
    return path


def pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


def folder(path: Path) -> Path:
    path.mkdir()
    return path


def unreadable(path: Path) -> Path:
    written(path, HEALTHY).chmod(0)
    return path


# What is wrong, how the file comes about, and a word of the refusal.
WRONG = {
    "unknown key": ("bus: {chanel: can0}", r':1: bus.chanel: unknown key; did you mean "channel"'),
    "wrong type": ("bus:\n  reopen_ms: soon", r":2: bus.reopen_ms: must be a whole number in ms"),
    "a unit": ("bus:\n  reopen_ms: 200 ms", r":2: bus.reopen_ms: must be a whole number in ms"),
    "out of range": ("bus:\n  reopen_ms: 1", r":2: bus.reopen_ms: must be at least 50 ms"),
    "duplicate key": ("bus:\n  reopen_ms: 60\n  reopen_ms: 70", r":3: .*reopen_ms"),
    "duplicate id": (
        "protocol:\n  aliases:\n    0x040CD079: IMU_Acceleration\n",
        r":3: .*stands for IMU_Attitude already",
    ),
    "limits crossed": (
        "freshness:\n  stale_after_ms: {BMS_Status: 900}\n  late_after_ms: {BMS_Status: 1000}\n",
        r":3: freshness.late_after_ms.BMS_Status: must be at most 900 ms",
    ),
    "more asked than allowed": (
        (
            "limits: {power_limit_max_w: 1000}\n"
            "bench:\n  demand: {bench_use_only: true, power_limit_w: 2000}\n"
        ),
        r":3: bench.demand.power_limit_w: must be at most 1000 W",
    ),
    "not a number": (
        "limits:\n  regen_limit_pct: .nan",
        r":2: limits.regen_limit_pct: must be a finite number",
    ),
    "infinity": (
        "limits:\n  regen_limit_pct: 1e999",
        r":2: limits.regen_limit_pct: must be a finite number",
    ),
    "10 MB": (b"# x\n" * 2_500_000, "is larger than 1 MiB"),
    "binary": (b"bus: \0\1\2", "is binary"),
    "UTF-16": ("bus: {}".encode("utf-16"), "is UTF-16 text"),
    "no UTF-8": (b"bus:\n  channel: \xff", r":2: is not UTF-8 text"),
    "empty": ("", "."),
    "only a comment": ("# nothing\n", "."),
    "a tab": ("bus:\n\tchannel: can0\n", ":2"),
    "a bomb of aliases": ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", ":2"),
    "missing": (lambda path: path, "there is no such file"),
    "through a file": (lambda path: written(path, "") / "x", "there is no such file"),
    "a loop": (loop, "leads back to itself"),
    "a folder": (folder, "is a directory"),
    "a pipe": (pipe, "is no regular file"),
    "unreadable": (unreadable, "may not read it"),
}


@pytest.mark.parametrize("what", WRONG)
def test_f60_a_wrong_configuration_is_refused_and_nothing_starts(what, tmp_path, seen: Seen):
    contents: Any
    contents, expected = WRONG[what]
    path = tmp_path / "gateway.yaml"
    path = contents(path) if callable(contents) else written(path, contents)
    if what == "unreadable" and os.geteuid() == 0:
        sentence = _refused_to_somebody(path)
    else:
        with pytest.raises(GatewayError) as refused:
            _loaded(path)
        unread = callable(WRONG[what][0])
        assert refused.value.exit_code == (os.EX_NOINPUT if unread else os.EX_CONFIG)
        sentence = str(refused.value)
    assert re.search(expected, sentence), sentence
    assert str(path) in sentence, "it says which file"
    seen(sentence.replace(str(tmp_path), "...").splitlines()[0][:120])


def _loaded(path: Path) -> None:
    config = configuration.load(path)

    if problems := configuration.check_against(config, load_protocol(config)):
        raise ConfigError(*problems)


def _refused_to_somebody(path: Path) -> str:
    """What a process without root's rights is told."""
    for parent in (path.parent, *path.parents[1:3]):
        parent.chmod(0o755)
    code = (
        "import os, sys; sys.path[:0] = sys.argv[2:]; os.setuid(65534)\n"
        "from pathlib import Path; from vcu_gateway.strict_yaml.file_text import read\n"
        "from vcu_gateway.errors import MissingInputError\n"
        "try: read(Path(sys.argv[1]))\n"
        "except MissingInputError as error: print(error)\n"
    )
    # Imported before the rights are given up: the program may lie where nobody else can read.
    code = code.replace("; os.setuid(65534)", "").replace("try:", "os.setuid(65534)\ntry:")
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, cwd=ROOT
    )
    return done.stdout.strip() or done.stderr


def test_f60_the_program_ends_with_78_and_what_is_right_is_no_error(tmp_path, seen: Seen):
    path = written(tmp_path / "gateway.yaml", "bus: {chanel: can0}\nbus2: 5\n")
    run = [sys.executable, "-m", "vcu_gateway", "run", "-c", str(path), "--duration", "1"]
    done = subprocess.run(run, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert done.returncode == os.EX_CONFIG
    assert len(done.stderr.splitlines()) == 2, "each thing wrong, and nothing else"
    assert done.stdout == ""
    for text in (b"\xef\xbb\xbf" + HEALTHY.encode(), HEALTHY.replace("\n", "\r\n").encode()):
        _loaded(written(path, text))
    seen("exit 78, a line for each mistake; BOM and CRLF are read")


BROKEN = ("limits: [", "limits: {power_limit_max_w: -1}", "lgo: {}", "\0", "# x\n" * 400_000)


class Reloaded(NamedTuple):
    """Some twenty ticks of wrong reloads; `stalls` is what a bystander missed meanwhile.

    Attributes:
        withheld: frames that the gateway counts as not sent, because they were late.
    """

    problems: int
    heard: list[bytes]
    missed: int
    done: int
    withheld: int
    stalls: int

    @property
    def good(self) -> bool:
        full = {frame[1] for frame in self.heard} == {77}  # throttle all the while
        return full and self.missed <= 1 + 2 * self.stalls

    def __str__(self) -> str:
        return (
            f"{self.problems} problems named; {len(self.heard)} command frames,"
            f" {self.missed} ticks skipped"
        )


@pytest.mark.clock
def test_f61_an_invalid_reload_changes_nothing_and_leaves_no_gap(tmp_path, seen: Seen):
    with bystander(tmp_path) as other, driven(tmp_path) as whole, moving(whole) as driver:
        before = driver.result("config.get")
        schedule, counters = whole.loop.schedule, whole.loop.connection.counters

        def reloaded() -> Reloaded:
            driver.until_driving()
            skipped, ticks = schedule.skipped, schedule.ticks
            withheld = sum(counters.refused.values())
            other.begin()
            commands(whole)
            problems: list[str] = []
            while schedule.ticks < ticks + 20:
                for text in BROKEN:
                    written(whole.file, unrecorded(tmp_path, whole._head + text))
                    problems += driver.request("config.reload")["error"]["data"]["problems"]
            whole.file.unlink()
            problems += driver.request("config.reload")["error"]["data"]["problems"]
            assert driver.result("config.get") == before
            missed, done = schedule.skipped - skipped, schedule.ticks - ticks
            heard = commands(whole)
            withheld = sum(counters.refused.values()) - withheld
            return Reloaded(len(problems), heard, missed, done, withheld, other.missed)

        found = once_more(reloaded, lambda one: one.good)
    for one in found:
        assert one.problems >= 6
        assert len(one.heard) + one.withheld >= 2 * (one.done - 1)
    seen(", then ".join(map(str, found)))


RELOADS: dict[str, list[str] | None] = {
    "limits: {throttle_slew_pct_per_s: 200}": None,
    "limits: {power_limit_max_w: 20000}": ["limits.power_limit_max_w"],
    "limits: {power_limit_max_w: 10000, throttle_slew_pct_per_s: 200}": None,
    "limits: {power_limit_max_w: 60000}": None,
    "protocol: {transmit_priority: 3}": None,
    "bus: {reopen_ms: 100}": None,
}


class Taken(NamedTuple):
    """What was changed by each reload, and the modes that it was asked in."""

    changed: dict[str, list[str] | None]
    modes: set[str]


@pytest.mark.clock
def test_f62_a_reload_while_armed_takes_stricter_limits_and_nothing_else(tmp_path, seen: Seen):
    folders = iter([tmp_path / "first", tmp_path / "second"])

    def taken() -> Taken:
        folder_ = folder(next(folders))
        found = Taken({}, set())
        with driven(folder_) as whole, moving(whole) as driver:
            for text in RELOADS:
                head = whole._head
                if text.startswith("bus"):
                    head, more = head.replace("bus: {", "bus: {reopen_ms: 100, "), ""
                else:
                    more = text
                written(whole.file, unrecorded(folder_, head + more))
                answer = driver.request("config.reload")
                found.changed[text] = answer["result"]["changed"] if "result" in answer else None
                found.modes.add(whole.mode)
            limits = driver.result("config.get")["values"]["limits"]
            if limits["power_limit_max_w"] == 20_000 and found.modes == {"active"}:
                driver.until_driving()
                whole.until(
                    lambda: {frame[6:8] for frame in commands(whole)} == {b"\x20\x4e"},
                    "20 kW on the bus",
                )
        return found

    # The mode is part of it: a machine that stands still stops the vehicle, and more is taken.
    found = once_more(taken, lambda one: one == Taken(RELOADS, {"active"}))[-1]
    seen(
        f"taken: {sum(map(bool, found.changed.values()))} of {len(RELOADS)}; the rest refused whole"
    )


# The DBC.

DBC = packaged("vcu.dbc").read_text()


def message(name: str) -> re.Match[str]:
    """The lines of one message of the DBC."""
    block = re.search(rf"^BO_ (\d+) {name}: .*\n( SG_ .*\n)*", DBC, re.MULTILINE)
    assert block
    return block


def changed(name: str, old: str, new: str) -> str:
    """The DBC with something else in one message."""
    block = message(name)[0]
    assert old in block
    return DBC.replace(block, block.replace(old, new))


def without(name: str, signal_name: str) -> str:
    """The DBC with one signal of one message left out."""
    block = message(name)
    text = DBC.replace(block[0], re.sub(rf" SG_ {signal_name} .*\n", "", block[0]))
    return re.sub(
        rf"^(VAL_|CM_ SG_|BA_.* SG_) {block[1]} {signal_name} .*;\n", "", text, flags=re.MULTILINE
    )


def started_with(folder_: Path, dbc: str) -> subprocess.CompletedProcess[str]:
    written(folder_ / "other.dbc", dbc)
    config = written(
        folder_ / "gateway.yaml",
        "bus: {interface: virtual, channel: alone}\nprotocol: {dbc: other.dbc}\n"
        f"api: {{enabled: false, socket_path: {folder_ / 'control.sock'}}}\n",
    )
    run = [sys.executable, "-m", "vcu_gateway", "run", "-c", str(config), "--duration", "0.3"]
    return subprocess.run(run, capture_output=True, text=True, cwd=ROOT, timeout=60)


DAMAGED = {
    "cut in a line": DBC[: DBC.index("SG_ MotorSpeed") + 5],
    "empty": "",
    "binary": "\x7fELF\1\2\3",
    "a message of four bytes": DBC.replace("BMS_Status: 8", "BMS_Status: 4"),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_f63_a_damaged_dbc_is_refused_at_the_start(what, tmp_path, seen: Seen):
    done = started_with(tmp_path, DAMAGED[what])
    assert done.returncode in (os.EX_DATAERR, os.EX_CONFIG), done.stderr
    first = done.stderr.splitlines()[0]
    assert first.startswith("error: ")
    seen(first.replace(str(tmp_path), "...")[:110])


OTHER = {
    "no battery message": DBC.replace("BMS_Status", "BMS_Other"),
    "no throttle": without("VCU_PCU1_Command", "Throttle"),
    "no motor speed": without("PCU2_Status2", "MotorSpeed"),
    "no fault level": without("BMS_Status", "CellUndervoltage"),
    "no life signal": without("BMS_Status", "LifeSignal"),
    "throttle elsewhere": changed("VCU_PCU1_Command", "Throttle : 8|8", "Throttle : 24|8"),
    "throttle of another scale": changed("VCU_PCU1_Command", "8|8@1+ (0.39", "8|8@1+ (1"),
    "no periods": re.sub(r"^BA_ .*Cycle.*\n", "", DBC, flags=re.MULTILINE),
    "another identifier": DBC.replace(str(0x8008A7D0), str(0x8008A9D0)),
}


@pytest.mark.parametrize("what", OTHER)
def test_f63_a_dbc_of_another_vehicle_is_refused_at_the_start(what, tmp_path, seen: Seen):
    done = started_with(tmp_path, OTHER[what])
    assert done.returncode in (os.EX_DATAERR, os.EX_CONFIG), done.stderr[-300:]
    assert "other.dbc" in done.stderr.splitlines()[0]
    seen(f"{what}: {done.stderr.splitlines()[0].replace(str(tmp_path), '...')[:110]}")


def test_f63_a_dbc_that_changes_under_a_running_gateway_changes_nothing(tmp_path, seen: Seen):
    dbc = written(tmp_path / "own.dbc", DBC)
    log = tmp_path / "log"
    with (
        log.open("wb") as stderr,
        program(tmp_path, "protocol: {dbc: own.dbc}\n", stderr=stderr.fileno()) as one,
    ):
        one.until_serving()
        digest = one.health()["protocol_digest"]
        written(dbc, DBC + "\n")
        one.process.send_signal(signal.SIGHUP)
        wait_until(lambda: "config_" in log.read_text(), "the reload", PATIENCE_S)
        after = one.health()
        one.end()
    assert after["protocol_digest"] == digest
    with program(tmp_path, "protocol: {dbc: own.dbc}\n") as one:
        one.until_serving()
        another = one.health()["protocol_digest"]
    assert another != digest
    seen(f"digest {digest} shown before and after the change, {another} after a restart")


def test_f63_a_throttle_in_another_place_never_leaves_the_gate(tmp_path, seen: Seen):
    written(tmp_path / "own.dbc", OTHER["throttle elsewhere"])
    config = (
        "protocol: {dbc: own.dbc}\n"
        "bench: {auto_arm: true, demand: {bench_use_only: true, throttle_pct: 50}}\n"
    )
    with driven(tmp_path, config) as whole:
        whole.until_mode("fault")
        blocked = dict(whole.loop.gateway.transmitter.gate.blocked)
        sentence = whole.latest_why.sentence()
        assert set(next_commands(whole, 20)) == {ZERO_TORQUE}
    assert blocked
    seen(f"the gate blocked {blocked} and latched: {sentence[:60]}")
