"""The demand's connection with a clock that the test owns: repeating, breaking, mending."""

import select
import socket

import pytest

from tests.client.fake_gateway import PATIENCE_S
from tests.client.vehicle import refused
from vcu_gateway.client import UnreachableError
from vcu_gateway.client.demand import DeadMan, DemandSession, request_values

MS = 1_000_000
S = 1_000_000_000
START_NS = 5_000 * S
PAUSE_NS = 100 * MS
PATIENCE_NS = 2 * S
DRIVING = request_values({"throttle_pct": 20})


@pytest.fixture
def session(gateway):
    session = DemandSession(gateway, DeadMan("driver", 300, hold_s=None), timeout_s=2.0)
    yield session
    session.close()


@pytest.fixture
def opened(session, fake):
    """Its first demand is granted."""
    fake.vehicle.demands_expire = False
    session.open(START_NS)
    settle(session, START_NS)
    return session


def heard(session):
    """Wait until the other end has said something, or ended."""
    assert select.select([session.socket], [], [], PATIENCE_S)[0]


def broken(session, fake, now_ns):
    """The gateway has gone and the session has noticed; when it tries again."""
    fake.stop()
    return lost(session, now_ns)


def lost(session, now_ns):
    """Read on until the connection has ended; when it tries again."""
    again_ns = now_ns
    while session.socket is not None:
        heard(session)
        again_ns = session.step(now_ns)
    return again_ns


def settle(session, now_ns):
    """Read on until everything is answered."""
    while not session.settled:
        heard(session)
        session.step(now_ns)


def throttles(fake):
    return [demand.throttle_pct for demand in fake.demands()]


def test_opening_asks_for_no_motion_at_once(session, fake):
    session.open(START_NS)
    fake.wait_for(lambda: throttles(fake) == [0])
    assert session.connected


def test_opening_without_a_gateway_is_unreachable(session, fake):
    fake.stop()
    with pytest.raises(UnreachableError):
        session.open(START_NS)
    assert not session.connected


def test_it_is_settled_once_everything_is_answered(session):
    session.open(START_NS)
    assert not session.settled
    heard(session)
    session.step(START_NS)
    assert session.settled


def test_nothing_is_repeated_before_it_is_due(opened, fake):
    assert opened.step(START_NS + PAUSE_NS - 1) == START_NS + PAUSE_NS
    assert opened.settled
    assert opened.step(START_NS + PAUSE_NS) == START_NS + 2 * PAUSE_NS
    assert not opened.settled
    fake.wait_for(lambda: len(fake.demands()) == 2)


def test_a_demand_that_was_asked_for_is_sent_without_a_step(opened, fake):
    opened.send_values(DRIVING, START_NS + MS)
    fake.wait_for(lambda: throttles(fake) == [0, 20])


def test_no_motion_can_be_asked_for_without_a_step(opened, fake):
    opened.send_values(DRIVING, START_NS + MS)
    opened.end_motion(START_NS + 2 * MS)
    fake.wait_for(lambda: throttles(fake) == [0, 20, 0])


# Breaking.


def test_a_break_is_settled_for_no_answer_can_come(opened, fake):
    opened.send_values(DRIVING, START_NS + MS)
    broken(opened, fake, START_NS + 2 * MS)
    assert opened.settled
    assert not opened.connected


def test_without_a_connection_nothing_is_kept_for_later(opened, fake):
    again_ns = broken(opened, fake, START_NS)
    opened.send_values(DRIVING, START_NS + MS)
    opened.release(START_NS + MS)
    fake.start()
    opened.open(again_ns)
    fake.wait_for(lambda: throttles(fake) == [0, 0])


def test_it_tries_again_after_a_pause_that_doubles_up_to_a_second(opened, fake):
    now_ns = START_NS
    again_ns = broken(opened, fake, now_ns)
    pauses_ms = []
    for _ in range(7):
        pauses_ms.append((again_ns - now_ns) // MS)
        assert opened.step(again_ns - 1) == again_ns
        now_ns = again_ns
        again_ns = opened.step(now_ns)
    assert pauses_ms == [50, 100, 200, 400, 800, 1000, 1000]


def test_it_does_not_connect_before_the_pause_is_over(opened, fake):
    again_ns = broken(opened, fake, START_NS)
    fake.start()
    opened.step(again_ns - 1)
    assert opened.socket is None
    opened.step(again_ns)
    assert opened.connected


def test_a_granted_demand_ends_the_doubling(opened, fake):
    again_ns = broken(opened, fake, START_NS)
    again_ns = opened.step(again_ns)
    fake.start()
    opened.step(again_ns)
    settle(opened, again_ns)
    assert broken(opened, fake, again_ns) == again_ns + 50 * MS


def test_a_connection_that_is_never_granted_anything_does_not_end_the_doubling(opened, fake):
    again_ns = broken(opened, fake, START_NS)
    fake.faults.full = True
    fake.start()
    opened.step(again_ns)
    assert lost(opened, again_ns) == again_ns + 100 * MS


def test_half_an_answer_of_the_old_connection_does_not_spoil_the_new_one(opened, fake):
    fake.faults.say["demand.set"] = b'{"jsonrpc":"2.0",'
    fake.faults.hang_up["demand.set"] = 1
    opened.send_values(DRIVING, START_NS + MS)
    again_ns = lost(opened, START_NS + 2 * MS)
    fake.faults.say.clear()
    opened.step(again_ns)
    settle(opened, again_ns)
    assert opened.connected


def test_a_gateway_that_answers_nothing_is_given_up_after_the_time_limit(opened, fake):
    fake.faults.silent.add("demand.set")
    asked_ns = START_NS + 10 * MS
    opened.send_values(DRIVING, asked_ns)
    opened.step(asked_ns + PATIENCE_NS)
    assert opened.connected
    opened.step(asked_ns + PATIENCE_NS + 1)
    assert opened.socket is None


def test_a_gateway_that_answers_the_latest_only_is_not_given_up(opened, fake):
    fake.faults.silent.add("demand.set")
    opened.send_values(DRIVING, START_NS)
    fake.wait_for(lambda: len(fake.demands()) == 2)
    fake.faults.silent.clear()
    opened.send_values(DRIVING, START_NS + PATIENCE_NS)
    heard(opened)
    opened.step(START_NS + PATIENCE_NS)
    opened.step(START_NS + 2 * PATIENCE_NS)
    assert opened.connected


def test_a_silence_while_nothing_is_unanswered_does_not_count(opened):
    opened.step(START_NS + 100 * S)
    assert opened.connected


def test_rubbish_is_a_break(opened, fake):
    fake.faults.say["demand.set"] = b"rubbish\n"
    opened.send_values(DRIVING, START_NS + MS)
    heard(opened)
    opened.step(START_NS + MS)
    assert opened.socket is None


def test_a_gateway_that_ends_with_the_demand_unread_is_a_break(tmp_path):
    with socket.socket(socket.AF_UNIX) as rude:
        rude.bind(str(tmp_path / "rude.sock"))
        rude.listen()
        session = DemandSession(tmp_path / "rude.sock", DeadMan("driver", 300, None), timeout_s=2.0)
        session.open(START_NS)
        rude.accept()[0].close()
        session.step(START_NS)
    assert session.socket is None


def test_what_is_told_unasked_is_no_answer(opened, fake):
    told = b'{"jsonrpc":"2.0","method":"news","params":{}}\n'
    fake.faults.say["demand.set"] = told + b'{"jsonrpc":"2.0","id":7,"result":{}}\n'
    before = opened.dead_man.last_answer
    opened.send_values(DRIVING, START_NS + MS)
    heard(opened)
    opened.step(START_NS + MS)
    assert opened.connected
    assert opened.dead_man.last_answer == before


def test_a_silence_before_anything_was_asked_does_not_count(opened):
    opened.send_values(DRIVING, START_NS + 100 * S)
    assert opened.step(START_NS + 100 * S) == START_NS + 100 * S + PAUSE_NS
    assert opened.connected


def test_a_gateway_that_reads_nothing_does_not_block_and_is_left(tmp_path):
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.bind(str(tmp_path / "deaf.sock"))
        deaf.listen()
        session = DemandSession(tmp_path / "deaf.sock", DeadMan("driver", 300, None), timeout_s=2.0)
        session.open(START_NS)
        sent = 0
        while session.connected:
            session.send_values(DRIVING, START_NS + sent)
            sent += 1
        assert sent > 10
        assert session.socket is not None  # Only a step closes it: another thread may wait on it.
        session.step(START_NS + S)
        assert session.socket is None


# Releasing.


def test_a_released_demand_is_not_repeated(opened, fake):
    opened.release(START_NS + MS)
    assert opened.step(START_NS + S) > START_NS + S
    settle(opened, START_NS + S)
    assert fake.methods() == ["demand.set", "demand.release"]


def test_a_released_demand_is_not_mended(opened, fake):
    opened.release(START_NS + MS)
    fake.restart()
    again_ns = lost(opened, START_NS + 2 * MS)
    opened.step(again_ns)
    assert opened.socket is None


def test_a_refused_release_is_no_refusal_of_a_demand(opened, fake):
    fake.faults.refuse["demand.release"] = refused("other_owner", "no")
    opened.release(START_NS + MS)
    settle(opened, START_NS + 2 * MS)
    assert opened.dead_man.refusal is None


def test_closing_ends_the_connection(opened, fake):
    opened.close()
    opened.close()
    fake.wait_for(lambda: not fake.open_connections)
