"""`check-config` answers what `run` will: the same checks, sentences and exit codes."""

import contextlib
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.docs.pages import INSTALL, blocks
from vcu_gateway import config as configuration
from vcu_gateway.cli import main
from vcu_gateway.daemon.events import EventLog
from vcu_gateway.daemon.reload import report_effect

ROOT = Path(__file__).parents[2]
NOBODY = 65_534
BRIEFLY = ("--duration", "0.1")  # should it start after all
GROUP = "api: {socket_group: no-such-group}\n"
NO_BUS = "bus: {interface: virtual}\napi: {enabled: false}\n"


class Answer(tuple[int, str, str]):
    """Exit code, and what a verb printed on stdout and stderr."""

    __slots__ = ()

    code = property(lambda self: self[0])
    out = property(lambda self: self[1])
    err = property(lambda self: self[2])


Ask = Callable[..., Answer]


@pytest.fixture
def ask(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Ask:
    def asked(*arguments: object) -> Answer:
        monkeypatch.setattr(sys, "argv", ["vcu-gateway", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        return Answer((code, *capsys.readouterr()))

    return asked


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user may enter; pytest's own are root's alone."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@contextlib.contextmanager
def without_rights() -> Iterator[None]:
    """As a user without rights, where the tests run as root; what is imported stays."""
    if os.geteuid() != 0:
        yield
        return
    os.setresuid(NOBODY, NOBODY, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)


def written(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def made(path: Path, make: Callable[[Path], object]) -> Path:
    make(path)
    return path


def large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(100_000_000)


def dbc(path: Path) -> Path:
    written(path.with_name("own.dbc"), "no DBC")
    return written(path, "protocol: {dbc: own.dbc}")


REFUSED: dict[str, tuple[int, Callable[[Path], Path]]] = {
    "missing": (66, lambda path: path),
    "a folder": (66, lambda path: made(path, Path.mkdir)),
    "a pipe": (66, lambda path: made(path, os.mkfifo)),
    "endless": (66, lambda _: Path("/dev/zero")),
    "a loop": (66, lambda path: made(path, lambda one: one.symlink_to(one))),
    "binary": (78, lambda path: written(path, b"\x7fELF\0\1\2")),
    "100 MB": (78, lambda path: made(path, large)),
    "wrong": (78, lambda path: written(path, "bus: {chanel: can0}")),
    "no such group": (78, lambda path: written(path, GROUP)),
    "no such user": (78, lambda path: written(path, "api: {operator_users: [no-such-user]}")),
    "a number no user has": (78, lambda path: written(path, "api: {socket_owner: '4294967295'}")),
    "a wrong DBC": (65, dbc),
    "a missing DBC": (78, lambda path: written(path, "protocol: {dbc: none.dbc}")),
    "a name too long for the kernel": (
        78,
        lambda path: written(path, f"bus: {{channel: {'ü' * 8}}}"),
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_file_that_is_refused_at_the_start_is_refused_by_check_config(ask, tmp_path, what):
    code, make = REFUSED[what]
    path = make(tmp_path / "gateway.yaml")
    checked, started = ask("check-config", "-c", path), ask("run", "-c", path, *BRIEFLY)
    assert checked == started
    assert (checked.code, checked.out) == (code, "")
    assert checked.err.startswith("error: ")
    assert checked.err.count("\n") == 1


@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_configuration_that_may_not_be_read_is_66_in_one_line(ask, open_folder, what):
    folder = open_folder / "etc"
    folder.mkdir()
    path = written(folder / "gateway.yaml", "bus: {chanel: can0}")
    assert ask("check-config", "-c", path) == ask("run", "-c", path, *BRIEFLY)
    (path if what == "file" else folder).chmod(0)
    with without_rights():
        checked, started = ask("check-config", "-c", path), ask("run", "-c", path, *BRIEFLY)
    folder.chmod(0o755)
    assert checked == started == (66, "", f"error: {path}: this user may not read it\n")


def test_a_file_for_another_machine_may_name_its_users_and_groups(ask, tmp_path):
    path = written(tmp_path / "gateway.yaml", GROUP)
    checked = ask("check-config", "--other-machine", "-c", path)
    assert (checked.code, checked.err) == (0, "")
    assert "users, groups and bus were not looked at" in checked.out.splitlines()[0]


def test_a_bus_that_is_not_there_is_not_called_valid_without_a_word(ask, tmp_path):
    path = written(tmp_path / "gateway.yaml", f"bus: {{channel: nobus0}}\n{NO_BUS.splitlines()[1]}")
    checked = ask("check-config", "-c", path)
    first, second, *_ = checked.out.splitlines()
    assert checked.code == 0
    assert first == f"{path}: valid; the gateway starts, and goes on without what is not there now:"
    assert second.startswith("  missing cannot open socketcan nobus0: no such interface; ")


def test_a_socket_that_cannot_be_made_is_told_as_the_start_tells_it(ask, tmp_path):
    text = f"bus: {{interface: virtual}}\napi: {{socket_path: {tmp_path}/none/control.sock}}"
    checked = ask("check-config", "-c", written(tmp_path / "gateway.yaml", text))
    assert f"  missing cannot listen at {tmp_path}/none/control.sock: " in checked.out
    (tmp_path / "none").mkdir()
    checked = ask("check-config", "-c", tmp_path / "gateway.yaml")
    assert checked.out.splitlines()[0] == f"{tmp_path / 'gateway.yaml'}: valid"


# Derating without effect.


@pytest.mark.parametrize(("most_w", "derated_w", "told"), [(5000, 5000, 1), (5000, 4999, 0)])
def test_a_derated_power_that_lowers_nothing_is_a_warning(ask, tmp_path, most_w, derated_w, told):
    limits = f"limits:\n  power_limit_max_w: {most_w}\n  derated_power_w: {derated_w}\n"
    path = written(tmp_path / "gateway.yaml", NO_BUS + limits)
    checked, log = ask("check-config", "-c", path), EventLog()
    assert checked.code == 0
    assert checked.out.startswith(f"{path}: valid\n")
    report_effect(configuration.load(path), log)
    events = [entry.event for entry in log.latest(9)]
    assert (len(checked.err.splitlines()), len(events)) == (told, told)
    if told:
        sentence = checked.err.removeprefix("warning: ").strip()
        assert sentence == (
            f"{path}:5: limits.derated_power_w has no effect: it is 5000, limits.power_limit_max_w"
            " is 5000; set it below that, as in derated_power_w: 2500"
        )
        assert (events[0].name, events[0].fields) == ("config_warning", {"problems": [sentence]})


@pytest.mark.parametrize("text", [
    (ROOT / "config" / "bench-vcan0.yaml").read_text(),
    (ROOT / "config" / "gateway.yaml").read_text(),
    *blocks(INSTALL, "yaml"),
])  # fmt: skip
def test_every_example_has_an_effect(text):
    assert configuration.check_effect(configuration.parse(text, "")) == []


# The gateway's socket.


def test_a_socket_that_this_user_may_not_open_is_77_in_one_line(ask, open_folder, monkeypatch):
    path = open_folder / "control.sock"
    monkeypatch.setenv("VCU_GATEWAY_SOCKET", str(path))
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        assert ask("status").code == os.EX_UNAVAILABLE, "and everything is imported"
        path.chmod(0)
        with without_rights():
            answer = ask("status")
    assert (answer.code, answer.out) == (os.EX_NOPERM, "")
    assert answer.err.startswith(f"error: no permission to open {path}: join the group that ")
    assert answer.err.count("\n") == 1
