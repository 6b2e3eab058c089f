"""A newcomer's terminal on a system: what is typed and seen, kept as a transcript."""

import re
import time
from collections.abc import Callable
from pathlib import Path

from tests.watch.terminals import Window

COLUMNS, LINES = 110, 40
ENDED = re.compile(r"^(\d+)$", re.MULTILINE)

# Each prompt tells how the command before it ended, to whoever reads the file.
PROFILE = """
export LANG=C.UTF-8
PS1='\\u@\\h:\\w\\$ '
PROMPT_COMMAND='echo $? >>~/.ended'
"""


class FailedError(Exception):
    """A command that ended otherwise than it should, or not in time."""


class Terminal:
    """A shell in a terminal, whose home is the folder `home`."""

    def __init__(self, name: str, command: str, home: Path) -> None:
        self._ended = home / ".ended"
        self._window = Window(f"vcu-systems-{name}-{time.time_ns()}", COLUMNS, LINES, command)
        self._commands = 1  # the first prompt comes after none
        self._pictures: list[str] = []

    def begin(self, line: str) -> None:
        """Type a command, as soon as the one before has ended."""
        self._wait(self._is_prompt, 60, "no prompt")
        self._window.type(line)
        self._commands += 1

    def run(
        self, line: str, wait_s: float, answer: str = "", ends: tuple[str, ...] = ("0",)
    ) -> None:
        """Type a command and wait for its end; `answer` is typed to a question ("[Y/n]")."""
        self.begin(line)
        if answer:
            self._wait(lambda: self._is_prompt() or self._asks(), wait_s, f"no end of: {line}")
            if not self._is_prompt():
                self._window.type(answer)
        self.end(line, wait_s, ends)

    def end(self, line: str, wait_s: float, ends: tuple[str, ...] = ("0",)) -> None:
        """Wait for the command's end, which must be one of these statuses."""
        self._wait(self._is_prompt, wait_s, f"no end of: {line}")
        status = self._statuses()[-1]
        if status not in ends:
            raise FailedError(f"exit status {status} of: {line}")

    def show(self, pattern: str, wait_s: float) -> None:
        """Wait for this on the screen, and keep the picture; FailedError if the command ends."""
        self._wait(
            lambda: (
                bool(re.search(pattern, self._window.screen, re.MULTILINE)) or self._is_prompt()
            ),
            wait_s,
            f"{pattern} was not seen",
        )
        if self._is_prompt():
            raise FailedError(f"it ended before {pattern} was seen")
        self._pictures.append(f"[on the screen]\n{self._window.screen.rstrip()}\n")

    def press(self, key: str) -> None:
        self._window.press(key)

    def text(self) -> str:
        """What was typed and seen so far; full screens come last."""
        return "\n".join([self._window.scrolled, *self._pictures])

    def close(self) -> None:
        self._window.close()

    def _statuses(self) -> list[str]:
        return ENDED.findall(self._ended.read_text()) if self._ended.exists() else []

    def _is_prompt(self) -> bool:
        return len(self._statuses()) >= self._commands

    def _asks(self) -> bool:
        return bool(re.search(r"\[Y/n\] *$", self._window.screen.rstrip()))

    def _wait(self, is_so: Callable[[], bool], wait_s: float, otherwise: str) -> None:
        end_s = time.monotonic() + wait_s
        while not is_so():
            if time.monotonic() > end_s:
                raise FailedError(f"{otherwise} (within {wait_s:.0f} s)")
            time.sleep(0.2)
