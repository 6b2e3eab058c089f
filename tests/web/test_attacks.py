"""Whatever is asked of the page: a signed-in browser's stop is on the bus within 150 ms."""

import functools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.pressing import PRESSES, attacking, judge, kinds, pressed_ms, told
from tests.web.attack import KINDS
from tests.web.conftest import PASSWORD
from tests.web.stand import ROOT, GatewayProcess, WebProcess, gateway_running, serving

NICENESS = 10
"""As systemd/vcu-gateway-web.service has it; a test says so."""


@pytest.fixture(scope="module")
def attacked_gateway(tmp_path_factory) -> Iterator[GatewayProcess]:
    with gateway_running(tmp_path_factory.mktemp("attacked")) as one:
        yield one


@pytest.fixture
def niced(
    tmp_path: Path, attacked_gateway: GatewayProcess, users_file: Path
) -> Iterator[WebProcess]:
    options = ("--users", str(users_file))
    with serving(tmp_path, attacked_gateway.socket_path, *options) as web:
        os.setpriority(os.PRIO_PROCESS, web.process.pid, NICENESS)
        yield web


@pytest.mark.clock
@pytest.mark.timeout(400)
@pytest.mark.parametrize("kind", kinds(KINDS, ["history", "held"]))
def test_a_stop_is_on_the_bus_within_150_ms_in_each_attack(attacked_gateway, niced, kind, capsys):
    attackers = niced.sign_in("anna", PASSWORD).headers["set-cookie"].partition(";")[0]
    assert niced.sign_in("otto", PASSWORD).status == 200
    before = attacked_gateway.ask("ticks")
    with attacking("tests.web.attack", kind, str(niced.port), attackers, PASSWORD):
        press = functools.partial(niced.act, "estop")
        times_ms = [pressed_ms(attacked_gateway, press) for _ in range(PRESSES)]
    with capsys.disabled():
        print(told(kind, times_ms))
    judge(times_ms, before, attacked_gateway.ask("ticks"))


def test_the_page_runs_here_as_nice_as_its_unit_has_it():
    unit = (ROOT / "systemd" / "vcu-gateway-web.service").read_text()
    assert f"\nNice={NICENESS}\n" in unit
