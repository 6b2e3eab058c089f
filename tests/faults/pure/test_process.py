"""The process and the machine around it go wrong: threads, logs, disks, descriptors."""

import contextlib
import fcntl
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

from tests.core.safety_world import ZERO_TORQUE
from tests.driven import Driven, driven
from tests.faults.conftest import ROOT, Seen
from tests.faults.invariants import check
from tests.faults.machine import Program, program
from tests.faults.speaking import Speaker

MS = 1_000_000
F_SETPIPE_SZ = 1031
STILL = {"throttle_pct": 0.0, "power_mode": "normal"}


@contextlib.contextmanager
def moving(whole: Driven, throttle_pct: float = 30.0) -> Iterator[Speaker]:
    """A gateway that drives while the block lasts: its demand is renewed on a thread."""
    whole.until_ready()
    over = threading.Event()
    with Speaker(whole.socket_path) as owner, Speaker(whole.socket_path) as asker:
        owner.demand(1, 0)
        asker.result("arm")

        def renew() -> None:
            sequence = 1
            while not over.wait(0.1):
                sequence += 1
                owner.demand(sequence, throttle_pct)

        thread = threading.Thread(target=renew)
        thread.start()
        try:
            code = round(throttle_pct / 0.39)
            whole.until(lambda: code in whole.throttles(), "throttle on the bus")
            yield asker
        finally:
            over.set()
            thread.join()


def commands(whole: Driven) -> list[bytes]:
    """Every command frame heard since the last call."""
    heard = []
    while frame := whole.ear.recv(0):
        if frame.arbitration_id in whole.nodes.command_ids:
            heard.append(bytes(frame.data))
    return heard


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_f53_a_decoder_that_raises_costs_its_frame_and_a_reader_that_is_gone_the_torque(
    tmp_path, seen: Seen
):
    with driven(tmp_path) as whole, moving(whole):
        counters = whole.daemon.door.counters
        store = whole.daemon.gateway.intake.store
        put = store.put

        def broken(name, decoded, arrival_ns):
            if name == "IMU_Attitude":
                raise ZeroDivisionError("a bug of ours")
            return put(name, decoded, arrival_ns)

        store.put = broken

        def ended(name, decoded, arrival_ns):
            raise SystemExit  # ends the reading thread

        whole.until(lambda: counters.receiver_bugs >= 20, "bugs that are counted")
        assert whole.mode == "active", "everything else was received"
        bugs = counters.receiver_bugs
        store.put = put
        store.put = ended
        gone_ns = time.monotonic_ns()
        whole.until_mode("fault")
        reaction_ms = (time.monotonic_ns() - gone_ns) / MS
        whole.throttles()
        time.sleep(0.2)
        assert set(commands(whole)) == {ZERO_TORQUE}
        sentence = whole.latest_why.sentence()
    assert reaction_ms < 1000
    seen(f"{bugs} bugs counted while driving on; without a reader: {sentence[:90]}", reaction_ms)


def test_f54_a_tick_that_hangs_sends_nothing_and_the_next_one_is_zero_torque_and_no_burst(
    tmp_path, seen: Seen
):
    with driven(tmp_path) as whole, moving(whole):
        schedule = whole.daemon.schedule
        skipped, ticks = schedule.skipped, schedule.ticks
        commands(whole)
        hung = threading.Event()

        def hang() -> None:
            hung.set()
            time.sleep(0.7)

        whole.daemon.inbox.post(hang)
        hung.wait()
        time.sleep(0.1)
        commands(whole)  # of the tick before
        time.sleep(0.4)
        assert commands(whole) == [], "nothing repeats the last throttle"
        whole.until(lambda: schedule.skipped > skipped, "the next tick")
        time.sleep(0.4)
        after = commands(whole)
        assert whole.mode == "fault"
        assert set(after) == {ZERO_TORQUE}
        missed, done = schedule.skipped - skipped, schedule.ticks - ticks
    assert missed >= 12
    assert len(after) <= 2 * done
    seen(f"0.7 s inside the tick: {missed} ticks skipped, none made up; zero torque, latched")


class Heard(NamedTuple):
    """A command frame on the virtual bus; the stamp is the sender's."""

    stamp_ns: int
    flags: int
    can_id: int
    data: bytes


def heard(whole: Driven) -> list[Heard]:
    frames = []
    while frame := whole.ear.recv(0):
        if frame.arbitration_id in whole.nodes.command_ids:
            stamp_ns = int(frame.timestamp * 1e9)
            frames.append(Heard(stamp_ns, 4, frame.arbitration_id, bytes(frame.data)))
    return frames


def test_f58_a_thread_that_never_yields_leaves_the_cadence(tmp_path, seen: Seen):
    """Worse than anything in the program: it computes without a pause, in this very process."""
    with driven(tmp_path) as whole, moving(whole):
        schedule = whole.daemon.schedule
        over = threading.Event()

        def compute() -> None:
            while not over.is_set():
                sum(range(1000))

        threads = [threading.Thread(target=compute) for _ in range(2)]
        heard(whole)
        skipped, ticks = schedule.skipped, schedule.ticks
        for thread in threads:
            thread.start()
        time.sleep(3)
        over.set()
        for thread in threads:
            thread.join()
        missed, done = schedule.skipped - skipped, schedule.ticks - ticks
        late_ms = sorted(schedule.recent_lateness_ns)[-done:][done // 2] / MS
        checked = check(heard(whole))
        mode = whole.mode
    assert checked.narrowest_ms >= 25
    assert missed <= done // 10
    assert mode == "active"
    seen(f"two such threads for 3 s: {missed} of {missed + done} ticks skipped, {checked},"
         f" half of them less than {late_ms:.1f} ms late")  # fmt: skip


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
    asked, end_s = 0, time.monotonic() + 20
    with contextlib.ExitStack() as stack:
        speakers = [stack.enter_context(Speaker(one.socket_path)) for _ in range(10)]
        while not until():
            assert time.monotonic() < end_s
            for speaker in speakers:
                speaker.socket.sendall(line * 16)
            for speaker in speakers:
                for _ in range(16):
                    speaker._reader.readline()
            asked += 16 * len(speakers)
    return asked


def survives(folder: Path, stderr: int | None, before: Callable[[], None] | None = None) -> str:
    """Run with this stderr, log until lines are lost, end; what was seen."""
    state = folder / "state.json"
    with program(folder, "", "--state-out", str(state), stderr=stderr, before=before) as one:
        one.until_serving()
        begun_s = time.monotonic()
        asked = log_much(
            one,
            lambda: time.monotonic() > begun_s + 1 and one.health()["log_lines_dropped"] > 0,
        )
        took_s = time.monotonic() - begun_s
        health = one.health()
        ended_s = one.end()
    ticks = json.loads(state.read_text())["ticks"]
    assert ended_s < 1.0
    # A busy machine may take a tick or two; a single write that waits would take them all.
    assert ticks["skipped"] <= 2, ticks
    assert ticks["done"] >= 15 * took_s
    return (
        f"{asked} lines in {took_s:.1f} s, {health['log_lines_dropped']} lost and counted,"
        f" {ticks['skipped']} ticks skipped, ended in {ended_s * 1000:.0f} ms"
    )


@pytest.mark.parametrize("stream", [full_pipe, pipe_without_reader, stopped_terminal])
def test_f65_a_log_that_nobody_reads_delays_no_tick_and_no_end(stream, tmp_path, seen: Seen):
    stderr = stream()
    try:
        seen(f"{stream.__name__}: {survives(tmp_path, stderr)}")
    finally:
        os.close(stderr)


def test_f65_closed_standard_streams_leave_their_numbers_to_nobody(tmp_path, seen: Seen):
    """Else the bus's socket would get number 2, and a message of the C library the bus."""

    def close_all() -> None:
        for number in (0, 1, 2):
            os.close(number)

    with program(tmp_path, before=close_all) as one:
        one.until_serving()
        leads_to = [os.readlink(f"/proc/{one.process.pid}/fd/{number}") for number in (0, 1, 2)]
        ended_s = one.end()
    assert leads_to == ["/dev/null"] * 3
    (tmp_path / "again").mkdir()
    told = survives(tmp_path / "again", None, lambda: os.close(2))
    assert ended_s < 1.0
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
    done = subprocess.run([sys.executable, "-m", "vcu_gateway", "fly"], stderr=writing, cwd=ROOT)
    os.close(writing)
    assert done.returncode == 2, "a failure stays one, though nobody reads of it"
    seen(f"{len(VERBS)} verbs end with 0 and without a word; a wrong verb with 2")


def test_f64_a_full_disk_under_the_log_costs_lines_and_no_tick(tmp_path, seen: Seen):
    full = os.open("/dev/full", os.O_WRONLY)
    try:
        seen(f"log on a full disk: {survives(tmp_path, full)}")
    finally:
        os.close(full)


@pytest.mark.parametrize("target", ["/dev/full", "/proc/version", "gone/state.json"])
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
        status = one.process.wait(20)
    lines = errors.read_text().splitlines()
    assert json.loads(lines[-2])["event"] == "stopped"
    assert lines[-1].startswith(f"error: {path}: cannot be written: ")
    assert status == os.EX_UNAVAILABLE
    seen(lines[-1].replace(str(tmp_path), "..."))


# Descriptors.


def test_f66_without_descriptors_the_bus_goes_on_and_the_api_recovers(tmp_path, seen: Seen):
    with driven(tmp_path) as whole, moving(whole) as asker:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        schedule = whole.daemon.schedule
        skipped = schedule.skipped
        spare = socket.socket(socket.AF_UNIX)
        free: list[int] = []
        highest = max(int(one) for one in os.listdir("/proc/self/fd"))
        resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 1, hard))
        try:
            with contextlib.suppress(OSError):
                while True:
                    free.append(os.dup(0))
            spare.connect(str(whole.socket_path))
            whole.throttles()
            refused = asker.say("config.reload")
            time.sleep(1.0)
            assert whole.throttles() == {77}, "it drives on"
            assert asker.result("why")["mode"] == "active", "who is in is served"
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            for one in free:
                os.close(one)
        spare.settimeout(5)
        spare.sendall(b'{"jsonrpc":"2.0","id":1,"method":"why"}\n')
        assert b'"result"' in spare.recv(65536), "who waited is served now"
        spare.close()
        assert asker.result("config.reload")["changed"] == [], "and a reload works again"
        missed = schedule.skipped - skipped
    assert "error" in refused
    assert missed <= 2
    seen(f"no descriptor for 1 s: {missed} ticks skipped, full throttle on the bus; then served")


def test_f66_descriptors_above_1023_are_as_good_as_any(tmp_path, seen: Seen):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    fillers: list[int] = []
    try:
        while not fillers or fillers[-1] < 1100:
            fillers.append(os.dup(0))
        with driven(tmp_path) as whole, moving(whole) as asker:
            assert asker.socket.fileno() > 1023
            whole.throttles()
            time.sleep(0.5)
            assert whole.throttles() == {77}
            numbers = map(int, os.listdir("/proc/self/fd"))
            highest = max(numbers)
    finally:
        for one in fillers:
            os.close(one)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    seen(f"driving with the API's sockets at numbers up to {highest}")
