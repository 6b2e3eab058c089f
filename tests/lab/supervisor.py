"""One command with a vcan0, from its start to its exit status.

Nothing of it stays behind but the console of a guest that failed, in a file.
"""

import contextlib
import os
import pathlib
import re
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque

TIMED_OUT, FAILED = 124, 125  # as timeout(1) has them
GRACE_S = 10  # between asking the command to end and killing it
NEVER = float("inf")
# What init or the guest's kernel says on the console before it gives up.
REASON = re.compile(r"^(?:lab: |.*Kernel panic - not syncing: )(.+)", re.MULTILINE)
# In the stack of a guest that died of it; the kernel's own words for it come through now and then.
REGISTERS, REFUSED = "put_fp_registers", "this machine's kernel refuses its registers (xstate.c)"


def say(message):
    print(f"lab: {message}", file=sys.stderr, flush=True)


def rank_before_others(leader):
    """Ranks a session before the others, where this is root: its tests judge by a clock.

    Where the kernel groups by session (autogroup), a process's own rank counts in there only.
    """
    with contextlib.suppress(OSError):
        pathlib.Path(f"/proc/{leader}/autogroup").write_text("-10", encoding="ascii")


class Supervisor:
    """Runs one process group, passes signals and output on, and keeps its time.

    job is a directory that goes when the supervisor ends, timeout_s its time in seconds or None;
    verbose shows the console of a guest that failed.
    """

    def __init__(self, job, timeout_s, verbose=False):
        self.job = job
        self.verbose = verbose
        self.ask_at = time.monotonic() + timeout_s if timeout_s else NEVER
        self.kill_at = NEVER
        self.cause = None  # the exit status that we are the cause of
        self.asked = deque()  # signals that we were sent
        self.process = self.undertaker = self.control = None
        self.pumps = {}  # file descriptor to read: where that goes, None for the guest's console
        self.console = deque(maxlen=50)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(number, lambda number, _frame: self.asked.append(number))

    def start(self, argv, **options):
        options.setdefault("stdin", subprocess.DEVNULL)
        self.process = subprocess.Popen(argv, start_new_session=True, **options)
        if os.nice(0) <= 0:  # the caller has not said that others go before
            rank_before_others(self.process.pid)
        # Should this process be killed, its end of the undertaker's pipe closes.
        bury = 'read -r _; kill -s KILL -- "-$1"; rm -rf -- "$2"'
        self.undertaker = subprocess.Popen(
            ["sh", "-c", bury, "sh", str(self.process.pid), self.job],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def start_guest(self, argv, consoles, interactive, environment):
        """Starts a kernel; consoles(control, keys, out, err) is how its options connect these."""
        (out, out_w), (err, err_w), (log, log_w) = os.pipe(), os.pipe(), os.pipe()
        (control_r, self.control), (keys_r, keys) = os.pipe(), os.pipe()
        self.pumps = {out: 1, err: 2, log: None, **({0: keys} if interactive else {})}
        self.start(
            [*argv, *consoles(control_r, keys_r, out_w, err_w)],
            stdout=log_w,
            stderr=log_w,
            pass_fds=(out_w, err_w, control_r, keys_r),
            env={**os.environ, **environment},
        )
        for fd in (out_w, err_w, log_w):
            os.close(fd)

    def watch(self):
        """Passes output on, live, until all has ended; returns the exit status."""
        with selectors.DefaultSelector() as selector:
            ended = os.pidfd_open(self.process.pid)
            for fd in (ended, *self.pumps):
                selector.register(fd, selectors.EVENT_READ)
            while selector.get_map().keys() - {0}:
                for key, _ in selector.select(0.1):
                    if key.fd == ended:
                        self.kill()  # what is left of its process group
                    if key.fd == ended or not self.pump(key.fd, self.pumps[key.fd]):
                        selector.unregister(key.fd)
                self.keep_time()
        return self.status()

    def pump(self, source, sink):
        """Passes on what has come; False at the end."""
        data = os.read(source, 1 << 16)
        if sink is None:
            self.console.append(data)
            return bool(data)
        left = memoryview(data)
        while left:
            with contextlib.suppress(BlockingIOError):  # the caller's pipe may be non-blocking
                left = left[os.write(sink, left) :]
        return bool(data)

    def keep_time(self):
        now = time.monotonic()
        if now >= self.ask_at:
            self.ask_at, self.cause = NEVER, TIMED_OUT
            self.ask(signal.SIGTERM)
        while self.asked:
            if self.cause:  # told twice: no more patience
                self.kill_at = now
            number = self.asked.popleft()
            self.cause = self.cause or 128 + number
            if number == signal.SIGQUIT:  # a power cut: nothing in the guest learns of it
                self.kill_at = now
            else:
                self.ask(number)
        if now >= self.kill_at:
            self.kill()

    def ask(self, number):
        """Passes a signal on to the command, which has a little time to end once it has begun."""
        grace_s = GRACE_S if self.begun() else 0
        self.kill_at = min(self.kill_at, time.monotonic() + grace_s)
        if self.control:
            os.write(self.control, signal.Signals(number).name.removeprefix("SIG").encode() + b"\n")
        else:
            self.kill(number)

    def kill(self, number=signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def status(self):
        status = self.guest_status() if self.control else self.process.wait()
        if self.cause == TIMED_OUT:
            if self.begun():
                say("timed out")
            else:
                self.say_failed("timed out before the command had begun")
        if self.cause == TIMED_OUT or status is None:
            return self.cause or self.guest_died()
        return status if status >= 0 else 128 - status

    def begun(self):
        return not self.control or (self.job / "began").exists()

    def guest_status(self):
        with contextlib.suppress(FileNotFoundError):
            return int((self.job / "status").read_text())
        return None

    def guest_died(self):
        self.say_failed("the guest died")
        return FAILED

    def say_failed(self, what):
        """One line, with the guest's own reason and the file that has its console."""
        log = b"".join(self.console).decode("utf-8", "replace").replace("\r", "")
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", prefix="vcu-lab-console.", suffix=".log", delete=False
        ) as file:
            file.write(log)
        found = REASON.search(log)
        reason = REFUSED if REGISTERS in log else found and found[1]
        say(f"{what}{f': {reason}' if reason else ''}; its console is in {file.name}")
        if self.verbose:
            sys.stderr.write("".join(log.splitlines(keepends=True)[-25:]))

    def end(self):
        for process in filter(None, (self.process, self.undertaker)):
            with contextlib.suppress(ProcessLookupError):
                for _ in range(50):  # helpers outlive the guest by some milliseconds
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
                    time.sleep(0.01)
        shutil.rmtree(self.job, ignore_errors=True)
