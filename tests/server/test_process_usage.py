"""Resources of this process, as /proc has them."""

import os
import resource

import pytest

from vcu_gateway.server import queries
from vcu_gateway.server.queries import process_usage as usage


def test_the_figures_are_those_of_this_process():
    told = usage()
    assert told["cpu_time_s"] > 0
    assert told["virtual_memory_bytes"] > told["resident_memory_bytes"] > 1_000_000
    before = told["open_fds"]
    with open(os.devnull):
        assert usage()["open_fds"] == before + 1
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert told["max_fds"] == (None if soft == resource.RLIM_INFINITY else soft)


@pytest.fixture
def proc(tmp_path, monkeypatch):
    """An empty /proc/self."""
    monkeypatch.setattr(queries, "_PROC", tmp_path)
    return tmp_path


def test_what_proc_does_not_have_is_none_and_raises_nothing(proc):
    told = usage()
    assert told["cpu_time_s"] > 0
    assert told["resident_memory_bytes"] is told["virtual_memory_bytes"] is told["open_fds"] is None


@pytest.mark.parametrize("contents", ["", "12", "many pages 0 0 0 0 0"])
def test_a_memory_line_of_another_shape_is_none(proc, contents):
    (proc / "statm").write_text(contents)
    assert usage()["resident_memory_bytes"] is None


def test_no_limit_of_open_files_is_none(monkeypatch):
    unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    monkeypatch.setattr(resource, "getrlimit", lambda _: unlimited)
    assert usage()["max_fds"] is None
