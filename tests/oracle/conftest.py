"""One bench for all tests of this folder: starting a gateway costs more than a trial."""

import gc
import os
import socket
import time

import pytest

from tests.oracle.api import RefusedError
from tests.oracle.wire import CHANNEL


def _can_is_missing() -> str | None:
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((CHANNEL,))
    except (OSError, AttributeError) as error:
        return f"no {CHANNEL} here: {error}; `make test-oracle` runs these in the lab"
    return None


@pytest.fixture(scope="session", autouse=True)
def a_real_vcan0():
    why = _can_is_missing()
    if why and (os.environ.get("CI") or os.environ.get("VCU_REQUIRE_CAN")):
        pytest.exit(why, returncode=1)
    if why:
        pytest.skip(why)


FIGURES = pytest.StashKey[list[str]]()


@pytest.fixture
def figures(request):
    """Lines that are printed at the end of the run, passed or not."""
    return request.config.stash.setdefault(FIGURES, [])


def pytest_terminal_summary(terminalreporter, config):
    if lines := config.stash.get(FIGURES, []):
        terminalreporter.section("seen by the oracle")
        for line in lines:
            terminalreporter.line(line)


@pytest.fixture(scope="session")
def the_bench(a_real_vcan0, tmp_path_factory, request):
    from tests.oracle.bench import Bench

    gc.collect()
    gc.freeze()  # no pauses of this process on the machine's one processor
    bench = Bench(tmp_path_factory.mktemp("oracle"))
    yield bench
    lines = request.config.stash.setdefault(FIGURES, [])
    counts = (
        f"trials repeated, the machine was slow: {bench.repeated}",
        f"tests taken again, the machine was not seen to be slow: {bench.unexplained}",
        f"frames left out, the machine was not seen to be slow: {bench.left_out}",
    )
    lines += counts
    bench.close()
    tests = request.session.testscollected
    assert bench.unexplained <= max(3, tests // 20), counts
    assert bench.left_out <= max(10, tests // 2), counts


def _sections(request):
    """What the configuration of a file's tests has besides the defaults."""
    return getattr(request.module, "SECTIONS", None)


@pytest.fixture
def bench(the_bench, request):
    """A gateway of the file's `SECTIONS` in STANDBY, all well; afterwards no frame broke a rule."""
    the_bench.recorder.forget()
    the_bench.run(_sections(request))
    the_bench.speeds(0)
    the_bench.standby()
    yield the_bench
    broken = the_bench.broken_rules()
    assert not broken, "\n".join(["frames that broke a rule:", *broken])


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Once more, up to twice, where a test failed while its machine stood still or was slow.

    Also where frames were left out: a gateway that leaves them out does so each time, or so often
    that the run fails at its end.
    """
    names = pyfuncitem._fixtureinfo.argnames
    arguments = {name: pyfuncitem.funcargs[name] for name in names}
    bench = pyfuncitem.funcargs.get("the_bench")
    for left in (2, 1, 0):
        began = time.monotonic()
        try:
            pyfuncitem.obj(**arguments)
        except (AssertionError, RefusedError):
            if not (left and bench and bench.disturbed(began)):
                raise
        else:
            if not (left and bench and bench.leaves_out()) or bench.rules.violations:
                return True
        bench.unexplained += not bench.machine_was_slow(began)
        _begin_again(bench, pyfuncitem.funcargs, _sections(pyfuncitem))
    raise AssertionError("unreachable")


def _begin_again(bench, fixtures, sections):
    bench.repeated += 1
    bench.speed.wait_for_quiet()
    bench.void()
    if "own_bench" in fixtures:
        bench.end()
        bench.vehicle.heal()
    if "bench" in fixtures or "cut_bench" in fixtures:
        bench.run(sections)
        bench.standby()


@pytest.fixture
def reloaded(bench):
    """Reload the running gateway's configuration with other keys; the defaults afterwards."""

    def reload(**sections):
        bench.gateway.configure(sections)
        bench.client.call("config.reload")

    yield reload
    bench.client.refusal("disarm")
    reload()
    bench.standby()


@pytest.fixture
def own_bench(the_bench):
    """For a test that starts gateways of its own; the frames are judged as everywhere."""
    the_bench.end()
    the_bench.speeds(0)
    the_bench.vehicle.heal()
    yield the_bench
    the_bench.end()
    broken = the_bench.broken_rules()
    assert not broken, "\n".join(["frames that broke a rule:", *broken])
