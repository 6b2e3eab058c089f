"""The programs under test, on whichever bus there is."""

import os
import subprocess
import sys

import pytest
from bench.live import PERIOD_NS, cadence, run
from bench.recorder import run as run_recorder
from bench.traffic import NOMINAL_PER_S
from bench.under_test import (
    C_A_FRAME,
    C_A_TICK,
    HERE,
    NAIVE,
    gateway,
    on_its_processor,
    run_folder,
)

SECONDS = 1.0


def stamps(*errors_us: int, missing: int = 0) -> list[int]:
    late = [0, *errors_us]
    return [(turn + missing * (turn > 2)) * PERIOD_NS + us * 1000 for turn, us in enumerate(late)]


def test_an_even_cycle_has_no_error_and_no_drift():
    found = cadence(stamps(0, 0, 0, 0, 0))
    assert (found.mean_off_ms, found.drift_ms, found.missed) == (0, 0, 0)
    assert found.errors_us == [0] * 5


def test_a_cycle_that_falls_behind_a_little_each_time_drifts():
    found = cadence(stamps(100, 200, 300, 400, 500))
    assert found.mean_off_ms == pytest.approx(0.1)
    assert found.drift_ms == pytest.approx(0.4)


def test_a_cycle_without_a_frame_is_missed_and_no_error():
    found = cadence(stamps(0, 0, 0, 0, missing=1))
    assert (found.missed, found.mean_off_ms) == (1, 0)


@pytest.mark.ci
@pytest.mark.clock
def test_a_timed_gateway_drives_and_times_every_tick():
    found = run(gateway(HERE), NOMINAL_PER_S, SECONDS)
    assert len(found.ticks) >= SECONDS * 10
    assert {tick.mode for tick in found.ticks} == {"active"}
    assert all(tick.cpu_ns > 0 for tick in found.ticks)
    assert found.stamps_ns
    assert found.woken_per_s > 0
    assert found.resident_mb > 10


@pytest.mark.ci
def test_a_gateway_of_another_tree_than_the_one_named_is_refused(tmp_path):
    (tmp_path / "src").mkdir()
    with pytest.raises(RuntimeError, match=f"not {tmp_path}"):
        run(gateway(tmp_path), NOMINAL_PER_S, 0.1)


@pytest.mark.ci
@pytest.mark.clock
@pytest.mark.parametrize("program", [NAIVE, C_A_TICK, C_A_FRAME], ids=lambda one: one.name)
def test_a_peer_sends_both_commands_every_50_ms(program):
    found = run(program, NOMINAL_PER_S, SECONDS)
    assert len(found.stamps_ns) + cadence(found.stamps_ns).missed >= SECONDS * 15
    assert found.offered > SECONDS * NOMINAL_PER_S / 2


@pytest.mark.ci
@pytest.mark.clock
def test_the_c_programs_wake_once_a_tick_and_once_a_frame():
    by_tick, by_frame = (run(program, NOMINAL_PER_S, SECONDS) for program in (C_A_TICK, C_A_FRAME))
    assert by_tick.woken_per_s < 30
    assert by_frame.woken_per_s > 3 * by_tick.woken_per_s


@pytest.mark.ci
def test_the_recorder_keeps_what_the_benchmark_hands_on():
    assert run_recorder(NOMINAL_PER_S, 1.1).mb_per_hour > 1


def test_programs_under_test_find_their_byte_code_whatever_the_caller_wants(monkeypatch):
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    with run_folder() as folder:
        environment = NAIVE.environment(folder)
    code = "import sys; print(sys.dont_write_bytecode, sys.pycache_prefix)"
    said = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert said.stdout.split()[0] == "False"
    assert str(HERE) not in said.stdout


def test_the_calling_thread_keeps_its_processors(tmp_path):
    before = os.sched_getaffinity(0)
    with on_its_processor():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before
