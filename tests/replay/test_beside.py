"""Work beside: its result, its error, and no process left over."""

import os
import signal
import time

import pytest

from vcu_gateway.errors import DataError, Problem
from vcu_gateway.replay.drive_replay import beside


@pytest.fixture(params=[1, 2], ids=["one processor", "two processors"])
def processors(request, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(request.param)))
    return request.param


def children():
    with open(f"/proc/self/task/{os.getpid()}/children") as file:
        return file.read().split()


def test_the_result_is_that_of_the_work(processors):
    with beside(lambda: (os.getpid(), "x" * 200_000)) as result:
        pid, text = result()
    assert len(text) == 200_000
    assert (pid == os.getpid()) == (processors == 1)


def test_an_error_is_raised_where_the_result_is_waited_for(processors):
    def fails():
        raise DataError(Problem("is torn", "here:5", "mend it"))

    with beside(fails) as result, pytest.raises(DataError, match="here:5: is torn; mend it"):
        result()


def test_nobody_waits_for_work_whose_result_is_not_wanted(processors):
    before, begun_s = children(), time.monotonic()
    with beside(lambda: time.sleep(60)):
        pass
    assert children() == before
    assert time.monotonic() - begun_s < 30


def test_work_whose_process_was_killed_is_done_here(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    own = os.getpid()

    def dies_elsewhere():
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return 5

    with beside(dies_elsewhere) as result:
        assert result() == 5


class _NeverHandedOnError(Exception):
    """What no process can hand on."""

    def __reduce__(self) -> str:
        raise TypeError("it cannot be pickled")


def test_an_error_that_no_process_hands_on_is_raised_and_leaves_no_trace(capfd):
    def fail() -> None:
        raise _NeverHandedOnError

    with pytest.raises(_NeverHandedOnError), beside(fail) as result:
        result()
    assert capfd.readouterr().err == ""
