"""The demand of a thread's owner, on a real socket; the arithmetic is in test_dead_man."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.client.fake_gateway import PATIENCE_S
from tests.client.scripted_gateway import Scripted
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.client import (
    ApiError,
    ApiTimeoutError,
    Client,
    ClientError,
    NoRightError,
    RefusedError,
    UnreachableError,
    sync_demand,
)

TTL_MS = 60
LONG_TTL_MS = 3000
S = 1_000_000_000
OTHER_OWNER = RequestError(ErrorCode.REFUSED, "cruise owns the demand", "other_owner")


@pytest.fixture
def client(gateway):
    """Patient: whatever is not noticed at once hangs."""
    with Client(gateway, timeout_s=60) as client:
        yield client


@pytest.fixture
def owner(client):
    """In standby; its last values hold."""
    with client.demand("driver", ttl_ms=TTL_MS, hold_s=None) as owner:
        yield owner


@pytest.fixture
def driver(client):
    """Active; stays so on a busy machine."""
    with client.demand("driver", ttl_ms=LONG_TTL_MS, hold_s=None) as owner:
        client.arm()
        yield owner


def throttles(fake):
    return [demand.throttle_pct for demand in fake.demands()]


def eventually(condition):
    """For what this process sees; the fake gateway has `wait_for`."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, "it did not happen"
        time.sleep(0.001)


# Entering.


def test_entering_asks_for_no_motion_so_that_arming_is_possible(client, driver, fake):
    assert throttles(fake)[0] == 0
    assert client.state([])["mode"] == "active"


def test_entering_returns_with_the_first_answer(owner):
    assert owner.connected
    assert owner.last_answer["granted"]
    assert owner.refusal is None


def test_entering_without_a_gateway_is_unreachable(tmp_path):
    with (
        pytest.raises(UnreachableError, match="systemctl start"),
        Client(tmp_path / "none.sock").demand("driver"),
    ):
        pytest.fail("it was entered")


@pytest.mark.parametrize(
    ("failure", "error"),
    [
        (OTHER_OWNER, RefusedError),
        (RequestError(ErrorCode.NO_RIGHT, "user 7 may not"), NoRightError),
        (RequestError(ErrorCode.INVALID_PARAMS, "source is too long"), ApiError),
    ],
)
def test_a_demand_that_is_refused_from_the_start_is_not_entered(client, fake, failure, error):
    fake.faults.refuse["demand.set"] = failure
    with pytest.raises(error, match=failure.sentence), client.demand("driver"):
        pytest.fail("it was entered")
    fake.wait_for(lambda: not fake.open_connections)


def test_a_gateway_that_does_not_answer_the_first_demand_is_a_timeout(gateway, fake):
    fake.faults.silent.add("demand.set")
    owner = Client(gateway, timeout_s=0.1).demand("driver")
    with pytest.raises(ApiTimeoutError, match="took no demand within"), owner:
        pytest.fail("it was entered")
    fake.wait_for(lambda: not fake.open_connections)


def test_a_failed_entry_does_not_wait_for_the_next_repetition(gateway, fake):
    fake.faults.silent.add("demand.set")
    owner = Client(gateway, timeout_s=0.1).demand("driver", ttl_ms=120_000)
    before_s = time.monotonic()
    with pytest.raises(ApiTimeoutError), owner:
        pytest.fail("it was entered")
    assert time.monotonic() - before_s < PATIENCE_S


def test_a_full_gateway_says_so_to_an_owner_too(client, fake):
    fake.faults.full = True
    with pytest.raises(ApiError) as raised, client.demand("driver"):
        pytest.fail("it was entered")
    assert raised.value.word == "too_many_clients"


def test_a_gateway_that_is_not_ready_yet_is_waited_for(client, fake):
    fake.vehicle.not_ready = True
    ready = threading.Thread(target=_ready_after_two_demands, args=(fake,))
    ready.start()
    with client.demand("driver", ttl_ms=TTL_MS) as owner:
        assert owner.last_answer["granted"]
        assert owner.refusal is None
    ready.join()


def _ready_after_two_demands(fake):
    fake.wait_for(lambda: len(fake.demands()) >= 2)
    fake.vehicle.not_ready = False


# Setting.


def test_every_set_is_sent_at_once_and_in_order(owner, fake):
    for pct in range(1, 101):
        owner.set(throttle_pct=pct)
    fake.wait_for(lambda: 100.0 in throttles(fake))
    sent = [pct for pct in throttles(fake) if pct]
    assert [pct for at, pct in enumerate(sent) if pct not in sent[:at]] == list(range(1, 101))


def test_a_set_does_not_wait_for_its_answer(owner, fake):
    fake.faults.late["demand.set"] = threading.Event()
    for pct in range(1, 21):
        owner.set(throttle_pct=pct)
    fake.faults.late["demand.set"].set()
    fake.wait_for(lambda: 20.0 in throttles(fake))


def test_what_was_set_reaches_the_command(client, driver):
    driver.set(PCU1={"throttle_pct": 10}, PCU2={"throttle_pct": 20, "motor_reverse": True})
    eventually(lambda: client.state([])["commands"]["PCU2"]["throttle_pct"] == 20)
    commands = client.state([])["commands"]
    assert commands["PCU1"]["throttle_pct"] == 10
    assert commands["PCU2"]["motor_reverse"]


def test_a_demand_is_stamped_when_set_was_called(owner, fake):
    before_ns = time.monotonic_ns()
    owner.set(throttle_pct=33)
    after_ns = time.monotonic_ns()
    fake.wait_for(lambda: 33.0 in throttles(fake))
    first = next(demand for demand in fake.demands() if demand.throttle_pct == 33)
    assert before_ns <= first.params["made_ns"] <= after_ns


def test_without_a_hold_the_values_are_repeated_with_fresh_stamps(owner, fake):
    owner.set(throttle_pct=33)
    fake.wait_for(lambda: throttles(fake).count(33.0) >= 4)
    stamps = [one.params["made_ns"] for one in fake.demands() if one.throttle_pct == 33]
    assert stamps == sorted(set(stamps))


def test_when_the_hold_ends_no_motion_is_sent_and_goes_on(client, fake):
    with client.demand("driver", ttl_ms=TTL_MS, hold_s=0.1) as owner:
        owner.set(throttle_pct=33)
        fake.wait_for(lambda: throttles(fake)[-3:] == [0, 0, 0] and 33 in throttles(fake))
        held = [one.params["made_ns"] for one in fake.demands() if one.throttle_pct == 33]
        assert held[-1] - held[0] < 0.1 * S
        assert owner.connected


def test_the_demand_stays_fresh_while_nobody_calls_set(client, driver, fake):
    seen = len(fake.demands())
    fake.wait_for(lambda: len(fake.demands()) >= seen + 4)
    assert client.state([])["mode"] == "active"


def test_keeping_a_demand_costs_next_to_no_processor_time(driver, fake):
    seen, before_s, before_cpu_s = (
        len(fake.demands()),
        time.monotonic(),
        time.process_time(),
    )
    fake.wait_for(lambda: len(fake.demands()) >= seen + 2)
    assert time.process_time() - before_cpu_s < 0.2 * (time.monotonic() - before_s)


def test_a_number_that_is_not_finite_is_refused_here_and_the_last_values_stand(owner, fake):
    owner.set(throttle_pct=33)
    with pytest.raises(ValueError, match="throttle_pct"):
        owner.set(throttle_pct=float("nan"))
    seen = len(fake.demands())
    fake.wait_for(lambda: len(fake.demands()) > seen + 1)
    assert throttles(fake)[-1] == 33


def test_several_threads_may_set_and_no_number_comes_twice(owner, fake):
    def setting():
        for pct in range(50):
            owner.set(throttle_pct=pct)

    threads = [threading.Thread(target=setting) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    fake.wait_for(lambda: len(fake.demands()) > 200)
    numbers = [demand.params["sequence"] for demand in fake.demands()]
    assert numbers == sorted(set(numbers))
    assert owner.refusal is None


def test_nothing_can_be_set_before_it_is_entered(client):
    with pytest.raises(ClientError, match="not entered"):
        client.demand("driver").set(throttle_pct=1)


# Refusals.


def test_a_refusal_is_readable_and_raised_by_the_next_set(owner, fake):
    owner.set(throttle_pct=101)
    eventually(lambda: owner.refusal is not None)
    assert owner.refusal.refusal == "out_of_range"
    with pytest.raises(RefusedError, match="must be 0 to 100"):
        owner.set(throttle_pct=20)
    assert 20 not in throttles(fake)


def test_after_a_refusal_no_motion_is_sent(owner, fake):
    owner.set(throttle_pct=50)
    owner.set(throttle_pct=101)
    fake.wait_for(lambda: throttles(fake)[-1] == 0)


def test_the_next_set_after_a_refusal_that_was_raised_drives_again(owner, fake):
    owner.set(throttle_pct=101)
    eventually(lambda: owner.refusal is not None)
    with pytest.raises(RefusedError):
        owner.set(throttle_pct=20)
    owner.set(throttle_pct=20)
    fake.wait_for(lambda: 20 in throttles(fake))
    eventually(lambda: owner.refusal is None)


def test_a_forgotten_controller_is_refused_by_the_gateway(owner):
    owner.set(PCU1={"throttle_pct": 5})
    eventually(lambda: owner.refusal is not None)
    assert owner.refusal.refusal == "controller_missing"


def test_an_unknown_value_is_refused_by_the_gateway(owner):
    owner.set(thrust_pct=5)
    eventually(lambda: owner.refusal is not None)
    assert owner.refusal.word == "invalid_params"


# Leaving.


def assert_left_with_no_motion_and_released(fake):
    fake.wait_for(lambda: not fake.open_connections)
    assert fake.methods()[-2:] == ["demand.set", "demand.release"]
    assert throttles(fake)[-1] == 0


def test_leaving_asks_for_no_motion_and_releases(client, fake):
    with client.demand("driver", hold_s=None) as owner:
        owner.set(throttle_pct=50)
    assert_left_with_no_motion_and_released(fake)


def test_leaving_by_an_exception_does_the_same_and_lets_it_pass(client, fake):
    def drive():
        with client.demand("driver", hold_s=None) as owner:
            owner.set(throttle_pct=50)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        drive()
    assert_left_with_no_motion_and_released(fake)


def test_no_motion_is_answered_before_the_demand_is_released(tmp_path, monkeypatch):
    monkeypatch.setattr(sync_demand, "RELEASE_TIMEOUT_S", PATIENCE_S)
    with Scripted(tmp_path / "scripted.sock") as gateway, ThreadPoolExecutor(1) as threads:
        owner = Client(gateway.path, timeout_s=60).demand("driver", ttl_ms=60_000)
        entered = threads.submit(owner.__enter__)
        gateway.grant()
        entered.result()
        released = threads.submit(owner.release)
        assert gateway.read()["params"]["values"]["throttle_pct"] == 0
        assert gateway.has_nothing_to_read()
        gateway.grant(gateway.last)
        assert gateway.read()["method"] == "demand.release"
        assert not released.done()
        gateway.grant(gateway.last)
        released.result()


def test_leaving_ends_the_drive(client):
    with client.demand("driver", ttl_ms=LONG_TTL_MS) as owner:
        client.arm()
        owner.set(throttle_pct=50)
        assert client.state([])["mode"] == "active"
    eventually(lambda: client.state([])["mode"] == "standby")


def test_leaving_leaves_no_thread(client):
    with client.demand("driver"):
        assert "demand driver" in [thread.name for thread in threading.enumerate()]
    assert "demand driver" not in [thread.name for thread in threading.enumerate()]


def test_releasing_by_hand_ends_it_and_once_more_does_nothing(client, fake):
    with client.demand("driver") as owner:
        owner.release()
        assert_left_with_no_motion_and_released(fake)
        assert not owner.connected
        with pytest.raises(ClientError, match="released"):
            owner.set(throttle_pct=1)
    assert fake.methods().count("demand.release") == 1


def test_a_released_demand_cannot_be_entered_again(client, owner):
    owner.release()
    with pytest.raises(ClientError, match="again"):
        owner.__enter__()


def test_a_gateway_that_hangs_does_not_hold_up_leaving_for_long(client, fake):
    with client.demand("driver") as owner:
        fake.faults.silent |= {"demand.set", "demand.release"}
        owner.set(throttle_pct=50)
        before_s = time.monotonic()
    assert time.monotonic() - before_s < PATIENCE_S / 2
    assert_left_with_no_motion_and_released(fake)


def test_leaving_without_a_gateway_is_no_error(client, fake):
    with client.demand("driver") as owner:
        fake.stop()
        eventually(lambda: not owner.connected)


def test_another_may_own_the_demand_afterwards(client, fake):
    with client.demand("driver"):
        pass
    fake.wait_for(lambda: not fake.open_connections)
    with client.demand("cruise") as owner:
        assert owner.last_answer["granted"]


# Breaks.


def test_an_owner_reconnects_to_a_restarted_gateway(owner, fake):
    fake.restart()
    fake.wait_for(lambda: fake.open_connections)
    eventually(lambda: owner.connected)


def test_waiting_for_a_gateway_costs_next_to_no_processor_time(owner, fake):
    fake.stop()
    eventually(lambda: not owner.connected)
    before_cpu_s = time.process_time()
    threading.Event().wait(0.3)
    assert time.process_time() - before_cpu_s < 0.06


def test_sequences_rise_across_reconnects(owner, fake):
    for _ in range(3):
        seen = fake.demands()[-1].connection
        fake.hang_up()
        fake.wait_for(lambda seen=seen: fake.demands()[-1].connection > seen)
    numbers = [demand.params["sequence"] for demand in fake.demands()]
    assert numbers == sorted(set(numbers))


def test_after_a_break_no_motion_is_asked_for_until_the_next_set(owner, fake):
    owner.set(throttle_pct=50)
    fake.wait_for(lambda: 50 in throttles(fake))
    old = fake.demands()[-1].connection
    fake.hang_up()
    fake.wait_for(lambda: len([d for d in fake.demands() if d.connection > old]) >= 3)
    assert {d.throttle_pct for d in fake.demands() if d.connection > old} == {0}
    owner.set(throttle_pct=30)
    fake.wait_for(lambda: throttles(fake)[-1] == 30)


def test_what_was_set_without_a_connection_is_never_sent_later(owner, fake):
    fake.stop()
    eventually(lambda: not owner.connected)
    owner.set(throttle_pct=50)
    seen = len(fake.demands())
    fake.start()
    fake.wait_for(lambda: len(fake.demands()) >= seen + 3)
    assert {one.throttle_pct for one in fake.demands()[seen:]} == {0}


def test_a_gateway_that_answers_nothing_any_more_is_left_for_a_new_connection(gateway, fake):
    with Client(gateway, timeout_s=1.0).demand("driver", ttl_ms=TTL_MS) as owner:
        old = fake.demands()[-1].connection
        fake.faults.silent.add("demand.set")
        owner.set(throttle_pct=50)
        fake.wait_for(lambda: fake.demands()[-1].connection > old)
        fake.faults.silent.clear()
        eventually(lambda: owner.connected)


def test_rubbish_from_the_gateway_ends_the_connection_not_the_owner(owner, fake):
    old = fake.demands()[-1].connection
    fake.faults.say["demand.set"] = b"rubbish\n"
    owner.set(throttle_pct=50)
    fake.wait_for(lambda: fake.demands()[-1].connection > old)
    fake.faults.say.clear()
    owner.set(throttle_pct=0)
    eventually(lambda: owner.connected)


def test_answers_in_single_bytes_are_answers(owner, fake):
    fake.faults.one_byte = True
    owner.set(throttle_pct=101)
    eventually(lambda: owner.refusal is not None)


# The process ends.

CHILD = """
import sys, threading
from vcu_gateway.client import Client
with Client(sys.argv[1]) as client, client.demand("driver", ttl_ms=3000, hold_s=None) as owner:
    client.arm()
    owner.set(throttle_pct=50)
    print("driving", flush=True)
    threading.Event().wait()
"""


@pytest.fixture
def child(gateway):
    with subprocess.Popen(
        [sys.executable, "-c", CHILD, gateway], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout.readline() == "driving\n"
        yield child
        child.kill()


def test_a_killed_owner_ends_its_demand_with_its_connection(child, client, fake):
    assert client.state([])["mode"] == "active"
    child.kill()
    fake.wait_for(lambda: len(fake.open_connections) == 1)
    eventually(lambda: client.state([])["mode"] == "standby")


def test_a_frozen_owner_lets_its_demand_expire(child, client):
    os.kill(child.pid, signal.SIGSTOP)
    eventually(lambda: client.state([])["mode"] == "standby")


def test_an_interrupted_owner_asks_for_no_motion_before_it_ends(child, fake):
    child.send_signal(signal.SIGINT)
    child.wait(PATIENCE_S)
    assert_left_with_no_motion_and_released(fake)


def test_an_owner_that_was_never_left_does_not_keep_the_process_alive(gateway, fake):
    program = (
        "import sys; from vcu_gateway.client import Client\n"
        "owner = Client(sys.argv[1]).demand('driver', hold_s=None).__enter__()\n"
        "owner.set(throttle_pct=50)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, gateway], timeout=PATIENCE_S)
    assert done.returncode == 0
    fake.wait_for(lambda: not fake.open_connections)
