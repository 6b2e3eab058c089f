"""The process and the machine around it go wrong: threads, logs, disks, descriptors."""

import contextlib
import fcntl
import gc
import itertools
import json
import os
import resource
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.core.simulated_drive import ZERO_TORQUE
from tests.driven import Driven, driven, wait_until
from tests.faults.conftest import ROOT, Seen
from tests.faults.judged_bus import Checked, check
from tests.faults.line_client import LineClient
from tests.faults.machine import Program, program
from tests.faults.pure.bystander import PATIENCE_S, bystander, once_more
from vcu_gateway.bus.reader import PlainBus

# A busy machine has what is measured taken once more.
pytestmark = pytest.mark.timeout(300)

MS = 1_000_000
F_SETPIPE_SZ = 1031
STILL = {"throttle_pct": 0.0, "power_mode": "normal"}


class Driver(LineClient):
    """Asks; what it demands is renewed on a thread and a connection of their own."""

    def __init__(self, whole: Driven, throttle_pct: float) -> None:
        super().__init__(whole.socket_path)
        self._whole = whole
        self._wanted_pct = throttle_pct
        self._asked_pct = 0.0
        self._owner = LineClient(whole.socket_path)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._renew)
        self._thread.start()

    def _renew(self) -> None:
        for sequence in itertools.count(1):
            self._owner.demand(sequence, self._asked_pct)
            if self._over.wait(0.1):
                return

    def until_driving(self) -> None:
        """Throttle on the bus; armed again where the machine stood still and that stopped it."""
        wait_until(self._drives, "throttle on the bus", PATIENCE_S)

    def _drives(self) -> bool:
        if self._whole.mode == "active":
            self._asked_pct = self._wanted_pct
            return round(self._wanted_pct / 0.39) in self._whole.throttles()
        self._asked_pct = 0.0
        self._whole.throttles()
        self.request("reset", level="service")
        self.request("arm")
        return False

    def let_go(self) -> None:
        self._over.set()
        self._thread.join()
        with self._owner:
            pass


@contextlib.contextmanager
def moving(whole: Driven, throttle_pct: float = 30.0) -> Iterator[Driver]:
    """A gateway that drives while the block lasts."""
    whole.until_ready()
    with Driver(whole, throttle_pct) as driver:
        try:
            driver.until_driving()
            yield driver
        finally:
            driver.let_go()


def commands(whole: Driven) -> list[bytes]:
    """Every command frame heard since the last call."""
    heard = []
    while frame := whole.other_node.recv(0):
        if frame.arbitration_id in whole.nodes.command_ids:
            heard.append(bytes(frame.data))
    return heard


class Heard(NamedTuple):
    """A command frame on the virtual bus; the stamp is the sender's."""

    stamp_ns: int
    flags: int
    can_id: int
    data: bytes


def heard(whole: Driven) -> list[Heard]:
    frames = []
    while frame := whole.other_node.recv(0):
        if frame.arbitration_id in whole.nodes.command_ids:
            stamp_ns = int(frame.timestamp * 1e9)
            frames.append(Heard(stamp_ns, 4, frame.arbitration_id, bytes(frame.data)))
    return frames


class LetGo(NamedTuple):
    """When the throttle ended, from a moment on; nothing but zero torque follows.

    Attributes:
        last_ms: to the last frame with throttle; zero_ms: to the frame after it.
    """

    last_ms: float
    zero_ms: float


def let_go(whole: Driven, since_ns: int) -> LetGo:
    """By the senders' stamps: whoever reads them may come late. `since_ns` is wall clock."""
    frames: list[Heard] = []

    def has_let_go() -> bool:
        frames.extend(heard(whole))
        return len(frames) >= 10 and not any(frame.data[1] for frame in frames[-10:])

    wait_until(has_let_go, "ten commands without throttle", PATIENCE_S)
    after = next(n for n in range(len(frames), -1, -1) if not n or frames[n - 1].data[1])
    assert {frame.data for frame in frames[after:]} == {ZERO_TORQUE}
    last_ns = frames[after - 1].stamp_ns if after else since_ns
    return LetGo((last_ns - since_ns) / MS, (frames[after].stamp_ns - since_ns) / MS)


def next_commands(whole: Driven, count: int) -> list[bytes]:
    """Those heard since the last call, and more until there are so many."""
    frames = commands(whole)

    def are_enough() -> bool:
        frames.extend(commands(whole))
        return len(frames) >= count

    wait_until(are_enough, f"{count} commands", PATIENCE_S)
    return frames


@pytest.mark.clock
def test_f53_a_decoder_that_raises_costs_its_frame_and_a_reader_that_is_gone_the_torque(
    tmp_path, seen: Seen
):
    with driven(tmp_path) as whole, moving(whole) as driver:
        counters = whole.loop.connection.counters
        store = whole.loop.gateway.receiver.store
        put = store.put

        def broken(name, decoded, arrival_ns):
            if name == "IMU_Attitude":
                raise ZeroDivisionError("a bug of ours")
            return put(name, decoded, arrival_ns)

        def mode_with_bugs() -> str:
            driver.until_driving()
            before, store.put = counters.receiver_bugs, broken
            whole.until(lambda: counters.receiver_bugs >= before + 20, "bugs that are counted")
            mode, store.put = whole.mode, put
            return mode

        modes = once_more(mode_with_bugs, lambda mode: mode == "active")
        bugs = counters.receiver_bugs
        driver.until_driving()
        heard(whole)
        bus = whole.loop.connection._bus
        assert isinstance(bus, PlainBus)
        bus._notifier.stop()
        found = let_go(whole, time.time_ns())
        whole.until_mode("fault")
        sentence = whole.latest_why.sentence()
    assert found.last_ms < 1000
    seen(
        f"{bugs} bugs counted while driving on ({', then '.join(modes)}); without a reader:"
        f" {sentence[:90]}",
        found.zero_ms,
    )


@pytest.mark.clock
def test_f54_a_tick_that_hangs_sends_nothing_and_the_next_one_is_zero_torque_and_no_burst(
    tmp_path, seen: Seen
):
    with driven(tmp_path) as whole, moving(whole):
        schedule = whole.loop.schedule
        skipped, ticks = schedule.skipped, schedule.ticks
        hung, over = threading.Event(), threading.Event()

        def hang() -> None:
            hung.set()
            over.wait(PATIENCE_S)

        whole.loop.work_queue.post(hang)
        assert hung.wait(PATIENCE_S)
        commands(whole)  # of the ticks before
        time.sleep(0.7)
        assert commands(whole) == [], "nothing repeats the last throttle"
        over.set()
        after = next_commands(whole, 10)
        assert whole.mode == "fault"
        assert set(after) == {ZERO_TORQUE}
        missed, done = schedule.skipped - skipped, schedule.ticks - ticks
    assert missed >= 12
    assert len(after) <= 2 * done
    seen(f"0.7 s inside the tick: {missed} ticks skipped, none made up; zero torque, latched")


class Hogged(NamedTuple):
    """Three seconds beside threads that never yield; `stalls` is what a bystander missed so."""

    missed: int
    done: int
    stalls: int
    late_ms: float
    mode: str
    checked: Checked

    @property
    def good(self) -> bool:
        drives = self.mode == "active" or self.stalls > 3
        return drives and self.missed <= max(self.done // 10, 2 * self.stalls)

    def __str__(self) -> str:
        return (
            f"{self.missed} of {self.missed + self.done} ticks skipped, {self.stalls} by a"
            f" bystander like it, {self.checked}, half of them less than {self.late_ms:.1f} ms late"
        )


@pytest.mark.ci
@pytest.mark.clock
def test_f58_a_thread_that_never_yields_leaves_the_cadence(tmp_path, seen: Seen):
    """Worse than anything in the program: it computes without a pause, in this very process."""
    with (
        bystander(tmp_path, hogs=2) as other,
        driven(tmp_path) as whole,
        moving(whole) as driver,
    ):
        schedule = whole.loop.schedule

        def hogged() -> Hogged:
            over = threading.Event()

            def compute() -> None:
                while not over.is_set():
                    sum(range(1000))

            threads = [threading.Thread(target=compute) for _ in range(2)]
            driver.until_driving()
            heard(whole)
            skipped, ticks = schedule.skipped, schedule.ticks
            other.begin()
            for thread in threads:
                thread.start()
            time.sleep(3)
            over.set()
            for thread in threads:
                thread.join()
            missed, done = schedule.skipped - skipped, schedule.ticks - ticks
            late_ms = sorted(list(schedule.recent_lateness_ns)[-done:])[done // 2] / MS
            checked = check(heard(whole))
            return Hogged(missed, done, other.missed, late_ms, whole.mode, checked)

        found = once_more(hogged, lambda one: one.good)
    assert all(one.checked.narrowest_ms >= 25 for one in found)
    seen(f"two such threads for 3 s: {', then '.join(map(str, found))}")


# The log and the disk.


def full_pipe() -> int:
    """The writing end of a pipe that holds no byte more and that nobody reads."""
    _reading, writing = os.pipe()
    fcntl.fcntl(writing, F_SETPIPE_SZ, 4096)
    os.write(writing, bytes(4096))
    return writing


def pipe_without_reader() -> int:
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def stopped_terminal() -> int:
    """A terminal whose other end nobody reads, with all that fits in it."""
    _master, slave = os.openpty()
    os.set_blocking(slave, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(slave, bytes(4096))
    os.set_blocking(slave, True)
    return slave


def log_much(one: Program, until: Callable[[], bool]) -> int:
    """Requests that are refused, a line of the log each; how many there were."""
    line = b'{"jsonrpc":"2.0","id":1,"method":"arm"}\n'
    asked, end_s = 0, time.monotonic() + PATIENCE_S
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(LineClient(one.socket_path)) for _ in range(10)]
        while not until():
            assert time.monotonic() < end_s
            for client in clients:
                client.socket.sendall(line * 16)
            for client in clients:
                for _ in range(16):
                    client._reader.readline()
            asked += 16 * len(clients)
            time.sleep(0.05)  # the log is to overflow, not the machine
    return asked


class Survived(NamedTuple):
    """A run whose log nobody took; `stalls`: ticks that an idle bystander missed meanwhile.

    Attributes:
        usual_s: what ending takes where the log is taken; asked only of an end above 1 s.
    """

    asked: int
    took_s: float
    lost: int
    skipped: int
    done: int
    stalls: int
    ended_s: float
    usual_s: float

    @property
    def good(self) -> bool:
        # A busy machine may take a tick or two; a single write that waits would take them all.
        ticks = self.skipped <= 2 + 2 * self.stalls
        return ticks and (self.ended_s < 1.0 or self.ended_s < 2 * self.usual_s)

    def __str__(self) -> str:
        return (
            f"{self.asked} lines in {self.took_s:.1f} s, {self.lost} lost and counted,"
            f" {self.skipped} ticks skipped, ended in {self.ended_s * 1000:.0f} ms"
        )


def survives(folder: Path, stderr: int | None, before: Callable[[], None] | None = None) -> str:
    """Run with this stderr, log until lines are lost, end; what was seen."""
    with bystander(folder) as other:

        def run() -> Survived:
            state = folder / "state.json"
            other.begin()
            with program(
                folder, "", "--state-out", str(state), stderr=stderr, before=before
            ) as one:
                one.until_serving()
                begun_s = time.monotonic()
                asked = log_much(
                    one,
                    lambda: (
                        time.monotonic() > begun_s + 1 and one.health()["log_lines_dropped"] > 0
                    ),
                )
                took_s = time.monotonic() - begun_s
                lost = one.health()["log_lines_dropped"]
                ended_s = one.end()
            stalls = other.missed
            ticks = json.loads(state.read_text())["ticks"]
            skipped, done = ticks["skipped"], ticks["done"]
            assert done + 2 * stalls >= 15 * took_s, ticks
            usual_s = end_of_a_run(folder) if ended_s >= 1.0 else 0.0
            return Survived(asked, took_s, lost, skipped, done, stalls, ended_s, usual_s)

        return ", then ".join(map(str, once_more(run, lambda one: one.good)))


def end_of_a_run(folder: Path) -> float:
    """How long the same program takes to end where its log is taken, s."""
    with program(folder) as one:
        one.until_serving()
        return one.end()


@pytest.mark.clock
@pytest.mark.parametrize("stream", [full_pipe, pipe_without_reader, stopped_terminal])
def test_f65_a_log_that_nobody_reads_delays_no_tick_and_no_end(stream, tmp_path, seen: Seen):
    stderr = stream()
    try:
        seen(f"{stream.__name__}: {survives(tmp_path, stderr)}")
    finally:
        os.close(stderr)


@pytest.mark.clock
def test_f65_closed_standard_streams_leave_their_numbers_to_nobody(tmp_path, seen: Seen):
    """Else the bus's socket would get number 2, and a message of the C library the bus."""

    def close_all() -> None:
        for number in (0, 1, 2):
            os.close(number)

    def end_s() -> float:
        with program(tmp_path, before=close_all) as one:
            one.until_serving()
            numbers = (0, 1, 2)
            leads_to = [os.readlink(f"/proc/{one.process.pid}/fd/{number}") for number in numbers]
            assert leads_to == ["/dev/null"] * 3
            return one.end()

    once_more(end_s, lambda found_s: found_s < 1.0 or found_s < 2 * end_of_a_run(tmp_path))
    (tmp_path / "again").mkdir()
    told = survives(tmp_path / "again", None, lambda: os.close(2))
    seen(f"numbers 0 to 2 are /dev/null; {told}")


VERBS = [["--help"], ["schema"], ["version"], ["run", "--help"], ["completion", "bash"]]


def test_f65_a_reader_of_our_output_that_has_gone_is_no_failure(seen: Seen):
    """`vcu-gateway schema | head -1`."""
    for verb in VERBS:
        writing = pipe_without_reader()
        done = subprocess.run(
            [sys.executable, "-m", "vcu_gateway", *verb],
            stdout=writing,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        os.close(writing)
        assert (done.returncode, done.stderr) == (0, ""), verb
    writing = pipe_without_reader()
    failed = subprocess.run([sys.executable, "-m", "vcu_gateway", "fly"], stderr=writing, cwd=ROOT)
    os.close(writing)
    assert failed.returncode == 2, "a failure stays one, though nobody reads of it"
    seen(f"{len(VERBS)} verbs end with 0 and without a word; a wrong verb with 2")


@pytest.mark.clock
def test_f64_a_full_disk_under_the_log_costs_lines_and_no_tick(tmp_path, seen: Seen):
    full = os.open("/dev/full", os.O_WRONLY)
    try:
        seen(f"log on a full disk: {survives(tmp_path, full)}")
    finally:
        os.close(full)


@pytest.mark.parametrize("target", ["/dev/full", "/proc/self/oom_score_adj", "gone/state.json"])
def test_f64_a_state_file_that_cannot_be_written_is_told_and_the_end_is_in_order(
    target, tmp_path, seen: Seen
):
    (tmp_path / "gone").mkdir()
    path = Path(target) if target.startswith("/") else tmp_path / target
    errors = tmp_path / "errors"
    with (
        errors.open("wb") as stderr,
        program(tmp_path, "", "--state-out", str(path), stderr=stderr.fileno()) as one,
    ):
        one.until_serving()
        (tmp_path / "gone").rmdir()
        one.process.terminate()
        status = one.process.wait(PATIENCE_S)
    lines = errors.read_text().splitlines()
    assert json.loads(lines[-2])["event"] == "stopped"
    assert lines[-1].startswith(f"error: {path}: cannot be written: ")
    assert status == os.EX_UNAVAILABLE
    seen(lines[-1].replace(str(tmp_path), "..."))


# Descriptors.


class Starved(NamedTuple):
    """A second without a descriptor; `stalls` is what an idle bystander missed."""

    missed: int
    stalls: int
    throttles: set[int]
    mode: str

    @property
    def good(self) -> bool:
        drives = self.throttles == {77} and self.mode == "active"
        return drives and self.missed <= 2 + 2 * self.stalls


@contextlib.contextmanager
def no_descriptors() -> Iterator[None]:
    """Every descriptor that this process may have is in use."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    free: list[int] = []
    highest = max(int(one) for one in os.listdir("/proc/self/fd"))
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 1, hard))
    try:
        with contextlib.suppress(OSError):
            while True:
                free.append(os.dup(0))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for one in free:
            os.close(one)


@pytest.mark.ci
@pytest.mark.clock
def test_f66_without_descriptors_the_bus_goes_on_and_the_api_recovers(tmp_path, seen: Seen):
    with bystander(tmp_path) as other, driven(tmp_path) as whole, moving(whole) as driver:
        schedule = whole.loop.schedule

        def starve() -> Starved:
            driver.until_driving()
            skipped = schedule.skipped
            other.begin()
            with socket.socket(socket.AF_UNIX) as spare:
                with no_descriptors():
                    spare.connect(str(whole.socket_path))
                    whole.throttles()
                    refused = driver.request("config.reload")
                    time.sleep(1.0)
                    throttles = whole.throttles()
                    mode = driver.result("why")["mode"]  # who is in is served
                spare.settimeout(PATIENCE_S)
                spare.sendall(b'{"jsonrpc":"2.0","id":1,"method":"why"}\n')
                assert b'"result"' in spare.recv(65536), "who waited is served now"
            assert "error" in refused
            assert driver.result("config.reload")["changed"] == [], "and a reload works again"
            return Starved(schedule.skipped - skipped, other.missed, throttles, mode)

        missed = [one.missed for one in once_more(starve, lambda one: one.good)]
    seen(
        f"no descriptor for 1 s: {', then '.join(map(str, missed))} ticks skipped, full throttle"
        " on the bus; then served"
    )


@pytest.mark.clock
def test_f66_descriptors_above_1023_are_as_good_as_any(tmp_path, seen: Seen):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    fillers: list[int] = []
    gc.collect()  # what is left over from other tests would free its numbers later
    try:
        while not fillers or fillers[-1] < 1100:
            fillers.append(os.dup(0))
        with driven(tmp_path) as whole, moving(whole) as driver:
            assert driver.socket.fileno() > 1023
            once_more(lambda: throttles_while_driving(whole, driver), lambda found: found == {77})
            numbers = map(int, os.listdir("/proc/self/fd"))
            highest = max(numbers)
    finally:
        for one in fillers:
            os.close(one)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    seen(f"driving with the API's sockets at numbers up to {highest}")


def throttles_while_driving(whole: Driven, driver: Driver) -> set[int]:
    """What half a second of driving puts on the bus."""
    driver.until_driving()
    whole.throttles()
    time.sleep(0.5)
    return whole.throttles()
