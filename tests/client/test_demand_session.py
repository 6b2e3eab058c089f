"""The demand's connection with a clock that the test owns: repeating, breaking, mending."""

import select
import socket

import pytest

from tests.client.fake_gateway import PATIENCE_S
from tests.client.vehicle import refused
from vcu_gateway.client import UnreachableError
from vcu_gateway.client.demand import request_values
from vcu_gateway.client.demand_session import DemandSession
from vcu_gateway.client.keeping import DeadMan

MS = 1_000_000
S = 1_000_000_000
START_NS = 5_000 * S
PAUSE_NS = 100 * MS
PATIENCE_NS = 2 * S
DRIVING = request_values({"throttle_pct": 20})


@pytest.fixture
def link(gateway):
    link = DemandSession(gateway, DeadMan("driver", 300, hold_s=None), timeout_s=2.0)
    yield link
    link.close()


@pytest.fixture
def opened(link, standin):
    """Its first demand is granted."""
    standin.vehicle.demands_expire = False
    link.open(START_NS)
    settle(link, START_NS)
    return link


def heard(link):
    """Wait until the other end has said something, or ended."""
    assert select.select([link.socket], [], [], PATIENCE_S)[0]


def broken(link, standin, now_ns):
    """The gateway has gone and the link has noticed; when it tries again."""
    standin.stop()
    return lost(link, now_ns)


def lost(link, now_ns):
    """Read on until the connection has ended; when it tries again."""
    again_ns = now_ns
    while link.socket is not None:
        heard(link)
        again_ns = link.step(now_ns)
    return again_ns


def settle(link, now_ns):
    """Read on until everything is answered."""
    while not link.settled:
        heard(link)
        link.step(now_ns)


def throttles(standin):
    return [demand.throttle_pct for demand in standin.demands()]


def test_opening_asks_for_no_motion_at_once(link, standin):
    link.open(START_NS)
    standin.wait_for(lambda: throttles(standin) == [0])
    assert link.connected


def test_opening_without_a_gateway_is_unreachable(link, standin):
    standin.stop()
    with pytest.raises(UnreachableError):
        link.open(START_NS)
    assert not link.connected


def test_it_is_settled_once_everything_is_answered(link):
    link.open(START_NS)
    assert not link.settled
    heard(link)
    link.step(START_NS)
    assert link.settled


def test_nothing_is_repeated_before_it_is_due(opened, standin):
    assert opened.step(START_NS + PAUSE_NS - 1) == START_NS + PAUSE_NS
    assert opened.settled
    assert opened.step(START_NS + PAUSE_NS) == START_NS + 2 * PAUSE_NS
    assert not opened.settled
    standin.wait_for(lambda: len(standin.demands()) == 2)


def test_a_demand_that_was_asked_for_is_sent_without_a_step(opened, standin):
    opened.ask(DRIVING, START_NS + MS)
    standin.wait_for(lambda: throttles(standin) == [0, 20])


def test_no_motion_can_be_asked_for_without_a_step(opened, standin):
    opened.ask(DRIVING, START_NS + MS)
    opened.still(START_NS + 2 * MS)
    standin.wait_for(lambda: throttles(standin) == [0, 20, 0])


# Breaking.


def test_a_break_is_settled_for_no_answer_can_come(opened, standin):
    opened.ask(DRIVING, START_NS + MS)
    broken(opened, standin, START_NS + 2 * MS)
    assert opened.settled
    assert not opened.connected


def test_without_a_connection_nothing_is_kept_for_later(opened, standin):
    again_ns = broken(opened, standin, START_NS)
    opened.ask(DRIVING, START_NS + MS)
    opened.release(START_NS + MS)
    standin.start()
    opened.open(again_ns)
    standin.wait_for(lambda: throttles(standin) == [0, 0])


def test_it_tries_again_after_a_pause_that_doubles_up_to_a_second(opened, standin):
    now_ns = START_NS
    again_ns = broken(opened, standin, now_ns)
    pauses_ms = []
    for _ in range(7):
        pauses_ms.append((again_ns - now_ns) // MS)
        assert opened.step(again_ns - 1) == again_ns
        now_ns = again_ns
        again_ns = opened.step(now_ns)
    assert pauses_ms == [50, 100, 200, 400, 800, 1000, 1000]


def test_it_does_not_connect_before_the_pause_is_over(opened, standin):
    again_ns = broken(opened, standin, START_NS)
    standin.start()
    opened.step(again_ns - 1)
    assert opened.socket is None
    opened.step(again_ns)
    assert opened.connected


def test_a_granted_demand_ends_the_doubling(opened, standin):
    again_ns = broken(opened, standin, START_NS)
    again_ns = opened.step(again_ns)
    standin.start()
    opened.step(again_ns)
    settle(opened, again_ns)
    assert broken(opened, standin, again_ns) == again_ns + 50 * MS


def test_a_connection_that_is_never_granted_anything_does_not_end_the_doubling(opened, standin):
    again_ns = broken(opened, standin, START_NS)
    standin.faults.full = True
    standin.start()
    opened.step(again_ns)
    assert lost(opened, again_ns) == again_ns + 100 * MS


def test_half_an_answer_of_the_old_connection_does_not_spoil_the_new_one(opened, standin):
    standin.faults.say["demand.set"] = b'{"jsonrpc":"2.0",'
    standin.faults.hang_up["demand.set"] = 1
    opened.ask(DRIVING, START_NS + MS)
    again_ns = lost(opened, START_NS + 2 * MS)
    standin.faults.say.clear()
    opened.step(again_ns)
    settle(opened, again_ns)
    assert opened.connected


def test_a_gateway_that_answers_nothing_is_given_up_after_the_time_limit(opened, standin):
    standin.faults.silent.add("demand.set")
    asked_ns = START_NS + 10 * MS
    opened.ask(DRIVING, asked_ns)
    opened.step(asked_ns + PATIENCE_NS)
    assert opened.connected
    opened.step(asked_ns + PATIENCE_NS + 1)
    assert opened.socket is None


def test_a_gateway_that_answers_the_latest_only_is_not_given_up(opened, standin):
    standin.faults.silent.add("demand.set")
    opened.ask(DRIVING, START_NS)
    standin.wait_for(lambda: len(standin.demands()) == 2)
    standin.faults.silent.clear()
    opened.ask(DRIVING, START_NS + PATIENCE_NS)
    heard(opened)
    opened.step(START_NS + PATIENCE_NS)
    opened.step(START_NS + 2 * PATIENCE_NS)
    assert opened.connected


def test_a_silence_while_nothing_is_unanswered_does_not_count(opened):
    opened.step(START_NS + 100 * S)
    assert opened.connected


def test_rubbish_is_a_break(opened, standin):
    standin.faults.say["demand.set"] = b"rubbish\n"
    opened.ask(DRIVING, START_NS + MS)
    heard(opened)
    opened.step(START_NS + MS)
    assert opened.socket is None


def test_a_gateway_that_ends_with_the_demand_unread_is_a_break(tmp_path):
    with socket.socket(socket.AF_UNIX) as rude:
        rude.bind(str(tmp_path / "rude.sock"))
        rude.listen()
        link = DemandSession(tmp_path / "rude.sock", DeadMan("driver", 300, None), timeout_s=2.0)
        link.open(START_NS)
        rude.accept()[0].close()
        link.step(START_NS)
    assert link.socket is None


def test_what_is_told_unasked_is_no_answer(opened, standin):
    told = b'{"jsonrpc":"2.0","method":"news","params":{}}\n'
    standin.faults.say["demand.set"] = told + b'{"jsonrpc":"2.0","id":7,"result":{}}\n'
    before = opened.keeping.last_answer
    opened.ask(DRIVING, START_NS + MS)
    heard(opened)
    opened.step(START_NS + MS)
    assert opened.connected
    assert opened.keeping.last_answer == before


def test_a_silence_before_anything_was_asked_does_not_count(opened):
    opened.ask(DRIVING, START_NS + 100 * S)
    assert opened.step(START_NS + 100 * S) == START_NS + 100 * S + PAUSE_NS
    assert opened.connected


def test_a_gateway_that_reads_nothing_does_not_block_and_is_left(tmp_path):
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.bind(str(tmp_path / "deaf.sock"))
        deaf.listen()
        link = DemandSession(tmp_path / "deaf.sock", DeadMan("driver", 300, None), timeout_s=2.0)
        link.open(START_NS)
        sent = 0
        while link.connected:
            link.ask(DRIVING, START_NS + sent)
            sent += 1
        assert sent > 10
        assert link.socket is not None  # Only a step closes it: another thread may wait on it.
        link.step(START_NS + S)
        assert link.socket is None


# Releasing.


def test_a_released_demand_is_not_repeated(opened, standin):
    opened.release(START_NS + MS)
    assert opened.step(START_NS + S) > START_NS + S
    settle(opened, START_NS + S)
    assert standin.methods() == ["demand.set", "demand.release"]


def test_a_released_demand_is_not_mended(opened, standin):
    opened.release(START_NS + MS)
    standin.restart()
    again_ns = lost(opened, START_NS + 2 * MS)
    opened.step(again_ns)
    assert opened.socket is None


def test_a_refused_release_is_no_refusal_of_a_demand(opened, standin):
    standin.faults.refuse["demand.release"] = refused("other_owner", "no")
    opened.release(START_NS + MS)
    settle(opened, START_NS + 2 * MS)
    assert opened.keeping.refusal is None


def test_closing_ends_the_connection(opened, standin):
    opened.close()
    opened.close()
    standin.wait_for(lambda: not standin.open_connections)
