"""Whatever is asked of the API: an emergency stop is on the bus within 150 ms."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.pressing import PRESSES, attacking, judge, kinds, pressed_ms, told
from tests.server.attack import KINDS, line
from tests.web.stand import GatewayProcess, gateway_running

QUESTIONS = 300


@pytest.fixture(scope="module")
def attacked(tmp_path_factory) -> Iterator[GatewayProcess]:
    with gateway_running(tmp_path_factory.mktemp("attacked")) as one:
        yield one


def stop_behind(gateway: GatewayProcess, text: bytes) -> None:
    stop_behind_at(gateway.socket_path, text)


def stop_behind_at(socket_path: Path, text: bytes = b"") -> None:
    """Connect, send this and an emergency stop behind it, and leave."""
    with socket.socket(socket.AF_UNIX) as one:
        one.connect(os.fspath(socket_path))
        one.sendall(text + line("estop", 2))


@pytest.mark.clock
@pytest.mark.timeout(200)
@pytest.mark.parametrize("kind", kinds(KINDS, ["reconnecting"]))
def test_a_stop_of_a_new_connection_is_on_the_bus_within_150_ms(attacked, kind, capsys):
    before = attacked.ask("ticks")
    with attacking("tests.server.attack", kind, os.fspath(attacked.socket_path)):
        times_ms = [
            pressed_ms(attacked, lambda: stop_behind(attacked, b"")) for _ in range(PRESSES)
        ]
    with capsys.disabled():
        print(told(kind or "quiet", times_ms))
    judge(times_ms, before, attacked.ask("ticks"))


@pytest.mark.clock
@pytest.mark.timeout(200)
@pytest.mark.parametrize("method", kinds(["why", "state.get", "events"], ["why"]))
def test_a_stop_behind_300_questions_is_on_the_bus_within_150_ms(attacked, method, capsys):
    text = line(method) * QUESTIONS
    before = attacked.ask("ticks")
    times_ms = [pressed_ms(attacked, lambda: stop_behind(attacked, text)) for _ in range(PRESSES)]
    with capsys.disabled():
        print(told(f"behind {QUESTIONS} {method}", times_ms))
    judge(times_ms, before, attacked.ask("ticks"))
