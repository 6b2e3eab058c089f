"""Real terminals: a window of tmux, and a bare pseudo-terminal whose every byte is seen."""

import contextlib
import fcntl
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTED = f"{sys.executable} -m tests.watch.scripted_view"
VCU_GATEWAY = f"{sys.executable} -m vcu_gateway"
WAIT_S = 60.0
HISTORY_LINES = 100_000


def require_tmux() -> None:
    """Fails where nobody can look at a real terminal."""
    if shutil.which("tmux") is None:
        pytest.fail("no tmux here: make tools")


class Window:
    """A shell, or another command, in a window of a tmux server of its own."""

    def __init__(self, name: str, columns: int, lines: int, command: str = "/bin/sh") -> None:
        self._tmux = ["tmux", "-L", name, "-f", "/dev/null"]
        environment = {key: value for key, value in os.environ.items() if key != "TMUX"}
        environment["LC_ALL"] = "C.UTF-8"
        environment.pop("NO_COLOR", None)
        size = ["-x", str(columns), "-y", str(lines)]
        options = ["set-option", "-g", "history-limit", str(HISTORY_LINES), ";"]
        options += ["set-option", "-gw", "remain-on-exit", "on", ";"]
        start = ["new-session", "-d", *size, "-c", str(ROOT), command]
        subprocess.run([*self._tmux, *options, *start], check=True, env=environment)
        self._socket = self.fact("socket_path")

    def _ask(self, *arguments: str) -> str:
        command = [*self._tmux, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    def type(self, line: str) -> None:
        """Type this and Enter."""
        self._ask("send-keys", "-l", line)
        self.press("Enter")

    def press(self, *keys: str) -> None:
        self._ask("send-keys", *keys)

    def resize(self, columns: int, lines: int) -> None:
        self._ask("resize-window", "-x", str(columns), "-y", str(lines))

    @property
    def screen(self) -> str:
        return self._ask("capture-pane", "-p")

    @property
    def scrolled(self) -> str:
        """Everything since the window was opened; lines that it broke are whole again."""
        return self._ask("capture-pane", "-p", "-J", "-S", "-").rstrip() + "\n"

    @property
    def screen_with_escapes(self) -> str:
        return self._ask("capture-pane", "-p", "-e")

    def fact(self, name: str) -> str:
        """What tmux knows of the terminal, such as alternate_on."""
        return self._ask("display-message", "-p", f"#{{{name}}}").strip()

    def until(self, pattern: str) -> str:
        """Wait for this on the screen, however slow this machine is."""
        end_s = time.monotonic() + WAIT_S
        while time.monotonic() < end_s:
            screen = self.screen
            if re.search(pattern, screen, re.MULTILINE):
                return screen
            time.sleep(0.02)
        raise AssertionError(f"{pattern} did not come:\n{self.screen}")

    def settings(self) -> str:
        """The line settings, as stty has them."""
        self.type("clear; echo is $(stty -g)")
        return self.until(r"^is \S+").split("is ")[-1].split()[0]

    def close(self) -> None:
        self._ask("kill-server")
        Path(self._socket).unlink(missing_ok=True)


@contextlib.contextmanager
def window(columns: int = 80, lines: int = 24) -> Iterator[Window]:
    require_tmux()
    made = Window(f"vcu-watch-{os.getpid()}-{time.monotonic_ns()}", columns, lines)
    try:
        yield made
    finally:
        made.close()


class Terminal:
    """A program on a pseudo-terminal of its own, as ssh gives it."""

    def __init__(self, command: str, environment: Mapping[str, str] | None, controls: bool) -> None:
        self.master, slave = pty.openpty()
        self._name = os.ttyname(slave)
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self.before = termios.tcgetattr(self.master)
        inherited = {key: value for key, value in os.environ.items() if key != "NO_COLOR"}
        self.process = subprocess.Popen(
            command.split(),
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd=ROOT,
            env={**inherited, "TERM": "xterm-256color", **(environment or {})},
            start_new_session=True,
            preexec_fn=_take_the_terminal if controls else None,  # noqa: PLW1509
        )
        os.close(slave)
        self.output = b""

    def until(self, pattern: bytes) -> None:
        """Read until this was written."""
        end_s = time.monotonic() + WAIT_S
        while not re.search(pattern, self.output):
            assert time.monotonic() < end_s, self.output[-2000:]
            self.read(0.05)

    def read(self, wait_s: float) -> None:
        readable, _, _ = select.select([self.master], [], [], wait_s)
        with contextlib.suppress(OSError):  # it has ended
            self.output += os.read(self.master, 65536) if readable else b""

    def stop_output(self) -> None:
        """Like a connection that is held up: whoever writes now waits."""
        slave = os.open(self._name, os.O_RDWR | os.O_NOCTTY)
        termios.tcflow(slave, termios.TCOOFF)
        os.close(slave)

    def press(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def ended(self) -> int:
        """The exit code; reads what is written until the end."""
        end_s = time.monotonic() + WAIT_S
        while self.process.poll() is None:
            assert time.monotonic() < end_s
            self.read(0.05)
        before = -1
        while before != len(self.output):
            before = len(self.output)
            self.read(0.1)
        return self.process.returncode

    @property
    def is_as_before(self) -> bool:
        """Whether the line settings are what they were."""
        return termios.tcgetattr(self.master) == self.before

    def hang_up(self) -> None:
        """What a dead ssh does."""
        os.close(self.master)
        self.master = -1

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        if self.master >= 0:
            os.close(self.master)


def _take_the_terminal() -> None:
    """So that the kernel tells this process when the terminal hangs up."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@contextlib.contextmanager
def terminal(
    command: str, environment: Mapping[str, str] | None = None, controls: bool = True
) -> Iterator[Terminal]:
    """Started and ended; `controls` as the kernel has it: who is told of a hang-up."""
    made = Terminal(command, environment, controls)
    try:
        yield made
    finally:
        made.close()
