"""Calls of both clients: results, errors, breaks, time."""

import gc
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.client.fake_gateway import PATIENCE_S
from tests.client.scripted_gateway import Scripted
from tests.client.vehicle import MESSAGES
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.client import (
    ApiError,
    ApiTimeoutError,
    ConfigRefusedError,
    DisconnectedError,
    GarbledError,
    NoRightError,
    RefusedError,
    UnreachableError,
)

SHORT_S = 0.3


@pytest.fixture
def client(kind, gateway):
    with kind(gateway) as client:
        yield client


@pytest.fixture
def hasty(kind, gateway):
    with kind(gateway, timeout_s=SHORT_S) as client:
        yield client


# A healthy gateway.


def test_the_state_has_every_message_or_those_that_were_asked_for(client):
    assert set(client.state()["messages"]) >= set(MESSAGES)
    assert set(client.state(["BMS_Status"])["messages"]) == {"BMS_Status"}
    assert client.state([])["messages"] == {}


def test_why_health_events_config_and_protocol_answer(client):
    assert client.why()["mode"] == "standby"
    assert client.health()["pid"] > 0
    assert client.events(limit=3)["events"] == []
    assert client.config()["digest"]
    assert client.protocol()["digest"]


def test_what_changes_is_granted_or_refused_with_a_reason(client):
    assert client.disarm()["granted"]
    assert client.reload()["changed"] == []
    with pytest.raises(RefusedError) as raised:
        client.arm()
    assert raised.value.refusal == "not_allowed_now"
    assert raised.value.sentence


def test_an_emergency_stop_needs_a_reset_at_service_level(client):
    client.estop()
    with pytest.raises(RefusedError):
        client.reset()
    assert client.reset("service")["mode"] == "standby"


def test_a_subscription_brings_one_update_after_the_other(client):
    with client.subscribe(["BMS_Status"], rate_hz=50) as updates:
        first, second = next(updates), next(updates)
    assert set(first["state"]["messages"]) == {"BMS_Status"}
    assert second["state"]["monotonic_ns"] > first["state"]["monotonic_ns"]


def test_all_calls_share_one_connection(client, fake):
    client.why()
    client.health()
    client.disarm()
    assert fake.accepted == 1


def test_nothing_connects_before_the_first_call(kind, fake):
    with kind(fake.path):
        assert fake.accepted == 0


def test_leaving_the_client_ends_its_connection(kind, fake):
    with kind(fake.path) as client:
        client.why()
    fake.wait_for(lambda: not fake.open_connections)


# Errors that the gateway answers with.


@pytest.mark.parametrize(
    ("code", "error"),
    [
        (ErrorCode.REFUSED, RefusedError),
        (ErrorCode.NO_RIGHT, NoRightError),
        (ErrorCode.CONFIG_REFUSED, ConfigRefusedError),
        (ErrorCode.NOT_READY, ApiError),
    ],
)
def test_an_error_is_raised_and_the_connection_goes_on(client, fake, code, error):
    fake.faults.refuse["config.reload"] = RequestError(code, "no", problems=("line 3",))
    with pytest.raises(error) as raised:
        client.reload()
    assert raised.value.problems == ("line 3",)
    client.why()
    assert fake.accepted == 1


def test_a_wrong_parameter_is_the_gateways_to_refuse(client):
    with pytest.raises(ApiError) as raised:
        client.state(["NO_SUCH_MESSAGE"])
    assert raised.value.word == "invalid_params"
    with pytest.raises(ApiError):
        client.events(limit=0)


def test_a_subscription_that_is_refused_says_so(client):
    with pytest.raises(ApiError, match="NO_SUCH_MESSAGE"):
        next(iter(client.subscribe(["NO_SUCH_MESSAGE"])))
    with pytest.raises(ApiError):
        next(iter(client.subscribe(rate_hz=0)))


def test_a_full_gateway_is_told_from_a_broken_one(client, fake):
    fake.faults.full = True
    with pytest.raises(ApiError) as raised:
        client.why()
    assert raised.value.word == "too_many_clients"


def test_a_call_that_only_tells_is_sent_once_more_after_a_break(client, fake):
    fake.faults.hang_up["why"] = 1
    assert client.why()["mode"] == "standby"
    assert fake.methods() == ["why", "why"]


def test_after_a_second_break_it_is_given_up(client, fake):
    fake.faults.hang_up["why"] = 2
    with pytest.raises(DisconnectedError, match=r"before it answered why$"):
        client.why()
    assert fake.methods() == ["why", "why"]


@pytest.mark.parametrize("method", ["disarm", "estop"])
def test_what_stops_the_vehicle_is_rather_sent_twice_than_left_in_doubt(client, fake, method):
    fake.faults.hang_up[method] = 1
    getattr(client, method)()
    assert fake.methods() == [method, method]


@pytest.mark.parametrize("method", ["arm", "reset", "reload"])
def test_a_call_that_changes_something_is_never_sent_twice(client, fake, method):
    wire_name = "config.reload" if method == "reload" else method
    fake.faults.hang_up[wire_name] = 1
    with pytest.raises(DisconnectedError, match=f"unknown whether {wire_name} was") as raised:
        getattr(client, method)()
    assert raised.value.carried_out is None
    client.why()
    assert fake.methods() == [wire_name, "why"]


def test_a_call_after_a_restart_of_the_gateway_reaches_the_new_one(client, fake):
    client.why()
    fake.restart()
    assert client.why()["mode"] == "standby"


def test_a_change_that_the_old_gateway_cannot_have_got_goes_to_the_new_one(client, fake):
    client.why()
    fake.restart()
    client.estop()
    assert fake.methods().count("estop") == 1


def test_a_gateway_that_is_gone_is_unreachable_and_the_sentence_says_what_to_do(client, fake):
    client.why()
    fake.stop()
    with pytest.raises(UnreachableError, match="systemctl start vcu-gateway"):
        client.why()
    with pytest.raises(UnreachableError):
        next(iter(client.subscribe()))
    fake.start()
    client.why()


def test_a_subscription_ends_with_its_connection(client, fake):
    updates = client.subscribe(rate_hz=50)
    next(updates)
    fake.hang_up()
    for _ in updates:
        pass
    assert next(updates, None) is None


def test_a_subscription_that_was_closed_brings_nothing_more(client, fake):
    updates = client.subscribe(rate_hz=50)
    next(updates)
    updates.close()
    assert next(updates, None) is None
    fake.wait_for(lambda: len(fake.open_connections) == 0)


@pytest.fixture
def open_files(client, fake):
    """How many there are more than before the test, once the fake gateway has closed its own."""
    client.why()
    client.close()
    fake.wait_for(lambda: not fake.open_connections)
    gc.collect()  # what it closed later would make up for what is left open
    before = len(os.listdir("/proc/self/fd"))

    def more():
        fake.wait_for(lambda: not fake.open_connections)
        return len(os.listdir("/proc/self/fd")) - before

    return more


def test_a_subscription_that_was_left_leaves_nothing_open(client, open_files):
    with client.subscribe(rate_hz=50) as updates:
        next(updates)
    assert open_files() <= 0
    assert next(updates, None) is None


def test_a_subscription_that_ended_leaves_nothing_open(client, fake, open_files):
    updates = client.subscribe(rate_hz=50)
    next(updates)
    fake.hang_up()
    assert all(update["lost"] == 0 for update in updates)
    assert open_files() <= 0
    assert next(updates, None) is None


def test_a_subscription_that_was_refused_leaves_nothing_open(client, open_files):
    with pytest.raises(ApiError) as raised:
        next(client.subscribe(["NO_SUCH_MESSAGE"]))
    assert open_files() <= 0
    assert raised.value.__traceback__  # It holds on to what the call had in its hands.


# An answer that is slow, cut up, or none.


def test_an_answer_in_single_bytes_is_an_answer(client, fake):
    fake.faults.one_byte = True
    assert client.why()["mode"] == "standby"


def test_half_an_answer_is_no_answer(client, fake):
    fake.faults.say["arm"] = b'{"jsonrpc":"2.0","id":1,"result":{"granted":true,'
    fake.faults.hang_up["arm"] = 1
    with pytest.raises(DisconnectedError, match="unknown whether arm was carried out"):
        client.arm()


def test_a_gateway_that_ends_with_the_request_unread_is_a_break(kind, tmp_path):
    with Scripted(tmp_path / "scripted.sock") as gateway, ThreadPoolExecutor(1) as threads:
        ending = threads.submit(gateway.end_unread)
        with kind(gateway.path) as client, pytest.raises(DisconnectedError, match="unknown"):
            client.arm()
        ending.result()


@pytest.mark.parametrize("rubbish", [b"HTTP/1.1 400 Bad\r\n\r\n", b"\xff\n", b"{}\n", b"\n"])
def test_rubbish_instead_of_an_answer_ends_the_connection(client, fake, rubbish):
    fake.faults.say["arm"] = rubbish
    with pytest.raises(GarbledError, match="unknown whether arm was carried out"):
        client.arm()
    client.why()
    assert fake.accepted == 2


def test_rubbish_instead_of_an_update_is_raised(client, fake):
    updates = client.subscribe(rate_hz=50)
    next(updates)
    fake.faults.say["state.update"] = b"{}\n"
    with pytest.raises(GarbledError):
        list(updates)
    assert next(updates, None) is None


def test_what_concerns_another_request_is_not_taken_for_an_answer(client, fake):
    other = b'{"jsonrpc":"2.0","id":999,"result":{"mode":"active"}}\n'
    told = b'{"jsonrpc":"2.0","method":"state.update","params":{}}\n'
    mine = b'{"jsonrpc":"2.0","id":1,"result":{"mode":"standby"}}\n'
    fake.faults.say["why"] = other + told + mine
    assert client.why()["mode"] == "standby"


def test_a_slow_answer_within_the_time_limit_is_waited_for(client, fake):
    fake.faults.late["why"] = threading.Event()
    release = threading.Thread(target=_release_after, args=(fake, "why"))
    release.start()
    assert client.why()["mode"] == "standby"
    release.join()


def _release_after(fake, method):
    fake.wait_for(lambda: method in fake.methods())
    fake.faults.late[method].set()


def test_no_answer_in_time_is_a_timeout_and_the_next_call_is_undisturbed(hasty, fake):
    fake.faults.silent.add("why")
    with pytest.raises(ApiTimeoutError, match=rf"no answer to why within {SHORT_S} s"):
        hasty.why()
    hasty.timeout_s = PATIENCE_S
    assert hasty.disarm()["granted"]
    fake.wait_for(lambda: len(fake.methods()) >= 2)
    assert sorted(fake.methods()) == ["disarm", "why"], "it was asked once"


def test_an_answer_that_never_ends_is_a_timeout(kind, tmp_path):
    with Scripted(tmp_path / "scripted.sock") as gateway, ThreadPoolExecutor(1) as threads:
        dribbling = threads.submit(gateway.dribble)
        with kind(gateway.path, timeout_s=0.3) as client, pytest.raises(ApiTimeoutError):
            client.why()
        dribbling.result()


def test_a_change_without_an_answer_in_time_is_said_to_be_unknown(hasty, fake):
    fake.faults.silent.add("arm")
    with pytest.raises(ApiTimeoutError, match="unknown whether arm was carried out"):
        hasty.arm()


def test_a_late_answer_is_not_taken_for_the_next_one(hasty, fake):
    fake.faults.late["why"] = threading.Event()
    with pytest.raises(ApiTimeoutError):
        hasty.why()
    fake.faults.late.pop("why").set()
    hasty.timeout_s = PATIENCE_S
    assert "digest" in hasty.config()


def test_a_subscription_that_falls_silent_is_a_timeout(kind, fake):
    fake.faults.say["state.update"] = b'{"jsonrpc":"2.0","method":"other","params":{}}\n'
    with (
        kind(fake.path, timeout_s=1.5) as client,
        client.subscribe(rate_hz=50) as updates,
        pytest.raises(ApiTimeoutError, match=r"no update within 1\.52 s"),
    ):
        next(updates)


def test_a_subscription_that_is_not_answered_is_a_timeout(hasty, fake):
    fake.faults.late["state.subscribe"] = threading.Event()
    with pytest.raises(ApiTimeoutError, match=r"state\.subscribe"):
        next(hasty.subscribe())
