"""What a process spent: a busy one, a starved one and a sleeping one differ."""

import os
import subprocess
import sys
import threading
import time

import pytest

from vcu_gateway.daemon import ticking_thread
from vcu_gateway.daemon.ticking_thread import ProcessorTime

MS = 1_000_000


def burn(seconds: float) -> None:
    end_ns = time.thread_time_ns() + int(seconds * 1e9)
    while time.thread_time_ns() < end_ns:
        pass


@pytest.fixture
def spent():
    one = ProcessorTime()
    yield one
    one.close()


def test_a_busy_process_has_used_the_processor_on_whichever_thread(spent):
    burn(0.05)
    assert spent.since_last().processor_ns >= 50 * MS
    other = threading.Thread(target=burn, args=(0.05,))
    other.start()
    other.join()
    assert spent.since_last().processor_ns >= 50 * MS


@pytest.mark.clock
def test_the_interval_is_that_between_two_looks(spent):
    spent.since_last()
    begun_ns = time.monotonic_ns()
    time.sleep(0.05)
    over_ns = spent.since_last().over_ns
    assert over_ns >= 50 * MS
    assert over_ns - (time.monotonic_ns() - begun_ns) < 5 * MS


def test_a_sleeping_one_has_not(spent):
    found = []
    for _ in range(5):  # other threads of the tests may be at work in one of them
        spent.since_last()
        time.sleep(0.05)
        found.append(spent.since_last().processor_ns)
    assert min(found) < 20 * MS


def test_a_starved_one_has_waited(spent):
    if spent.since_last().waited_ns is None:
        pytest.skip("this kernel does not tell")
    cpu = min(os.sched_getaffinity(0))
    before = os.sched_getaffinity(0)
    loop = f"import os; os.sched_setaffinity(0, [{cpu}])\nprint(flush=True)\nwhile True: pass"
    with subprocess.Popen([sys.executable, "-c", loop], stdout=subprocess.PIPE) as hog:
        assert hog.stdout is not None
        hog.stdout.readline()
        os.sched_setaffinity(0, [cpu])
        try:
            spent.since_last()
            burn(0.2)
            waited_ns = spent.since_last().waited_ns
        finally:
            os.sched_setaffinity(0, before)
            hog.kill()
    assert waited_ns is not None
    assert waited_ns > 20 * MS


@pytest.mark.parametrize("contents", [None, "", "12", "a b c"])
def test_where_the_kernel_does_not_tell_the_wait_is_unknown(tmp_path, monkeypatch, contents):
    path = tmp_path / "schedstat"
    if contents is not None:
        path.write_text(contents)
    monkeypatch.setattr(ticking_thread, "_SCHEDSTAT", str(path))
    one = ProcessorTime()
    assert one.since_last().waited_ns is None
    one.close()
    one.close()
