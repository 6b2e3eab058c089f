"""The server: who is let in, what is answered, and what a hostile client gains: nothing."""

import contextlib
import gc
import json
import os
import resource
import socket
import threading
import time
from types import SimpleNamespace

import pytest

from tests.server.conftest import (
    EVERYONE,
    KNOWN,
    MS,
    NO_ONE,
    NOBODY,
    PATIENCE_S,
    Client,
    a_stranger,
    eventually,
)
from vcu_gateway.api.errors import ErrorCode, RequestError, Right
from vcu_gateway.api.methods import DemandParams, Nothing
from vcu_gateway.server.acceptor import Acceptor
from vcu_gateway.server.service import Counters, ServerSettings, SessionLimits
from vcu_gateway.server.session import EVICTED, SubscriptionState
from vcu_gateway.server.tick_gaps import TickGaps

SHORT = SessionLimits(timeout_ns=300 * MS)
# Where a test has to be done with something before it is over, also on a busy machine.
LONGER = SessionLimits(timeout_ns=1500 * MS)
BIG = "x" * 400_000  # more than the kernel buffers for a connection
DEMAND = {"source": "pedal", "sequence": 1, "values": {}}


def a_reader(api) -> Client:
    with a_stranger():
        return api.connect()


# Answers.


def test_a_request_is_answered_with_its_id(client):
    client.request("state.get", "a word")
    answer = client.line()
    assert (answer["jsonrpc"], answer["id"]) == ("2.0", "a word")
    assert answer["result"]["answer"] == "state.get"


def test_the_service_gets_the_method_the_parameters_and_the_caller(api, client):
    client.request("demand.set", **DEMAND)
    eventually(lambda: api.service.begun)
    ((method, params, caller),) = api.service.begun
    assert method == "demand.set"
    assert isinstance(params, DemandParams)
    assert (caller.peer.pid, caller.peer.uid) == (os.getpid(), os.geteuid())
    assert caller.peer.groups == {os.getegid(), *os.getgroups()}
    assert caller.rights == frozenset(Right)


def test_an_answer_may_come_later_and_from_another_thread(api, client):
    client.request("arm", 5)
    eventually(lambda: api.service.held)
    api.service.release()
    assert client.line() == {
        "jsonrpc": "2.0",
        "id": 5,
        "result": {"granted": True, "mode": "standby"},
    }


def test_a_failure_is_answered_as_an_error_and_counted(api, client):
    client.request("arm", 5)
    eventually(lambda: api.service.held)
    api.service.release(RequestError(ErrorCode.REFUSED, "a fault is latched", "not_allowed_now"))
    assert client.line()["error"]["message"] == "a fault is latched"
    assert client.ask("stat.get")["code"] == ErrorCode.METHOD_NOT_FOUND.value
    assert api.counts()["errors"] == {"refused": 1, "method_not_found": 1}
    assert api.counts()["requests"] == 2


def test_requests_of_one_connection_may_be_answered_in_any_order(api, client):
    client.request("arm", 1)
    client.request("state.get", 2)
    assert client.line()["id"] == 2
    api.service.release()
    assert client.line()["id"] == 1


def test_a_second_reply_to_the_same_request_goes_nowhere(api, client):
    client.request("arm", 1)
    eventually(lambda: api.service.held)
    api.service.held *= 2
    api.service.release()
    assert client.line()["id"] == 1
    assert client.ask("why", 2)


def test_a_notification_is_carried_out_and_not_answered(api, client):
    client.notify("estop")
    client.notify("state.get")
    eventually(lambda: len(api.service.begun) == 2)
    api.service.release()
    assert client.ask("why", 3)


def test_a_notification_that_fails_is_neither_answered_nor_counted(api, client):
    client.notify("x")
    client.notify("state.get", x=1)
    client.notify("state.unsubscribe", subscription=1)
    client.notify("arm")
    eventually(lambda: api.service.held)
    api.service.release(RequestError(ErrorCode.REFUSED, "not now", "not_allowed_now"))
    assert client.ask("why", 3)
    assert api.counts()["errors"] == {}
    assert api.counts()["requests"] == 5


def test_lines_may_arrive_in_any_pieces(client):
    data = b'{"jsonrpc":"2.0","id":1,"method":"why"}\n' * 3
    for start in range(0, len(data), 7):
        client.send(data[start : start + 7])
    assert [client.line()["id"] for _ in range(3)] == [1, 1, 1]


@pytest.mark.parametrize(
    "line",
    [
        b"\n",
        b"\xff\xfe\x00\n",
        b"[" * 60_000 + b"\n",
        b'{"id":1' + b"0" * 60_000 + b"}\n",
        b'{"jsonrpc":"2.0","id":1,"method":"why","params":{"a":NaN}}\n',
        b'{"jsonrpc":"2.0","id":1,"id":1,"method":"why"}\n',
        b"\x00" * 65_536 + b"\n",
    ],
    ids=["nothing", "UTF-16", "nested", "huge number", "NaN", "twice", "zeros"],
)
def test_nonsense_is_answered_and_the_connection_goes_on(api, client, line):
    client.send(line)
    assert client.line()["error"]["code"] == ErrorCode.PARSE_ERROR.value
    assert client.ask("why")
    assert api.counts()["errors"] == {"parse_error": 1}
    assert not api.service.calls_of("log_closed")


GRIEVANCES = {
    "nonsense": b"nonsense",
    "unknown method": b'{"jsonrpc":"2.0","id":1,"method":"x"}',
    "wrong params": b'{"jsonrpc":"2.0","id":1,"method":"state.get","params":{"x":1}}',
    "unknown message": (
        b'{"jsonrpc":"2.0","id":1,"method":"state.subscribe","params":{"messages":["x"]}}'
    ),
    "no subscription": (
        b'{"jsonrpc":"2.0","id":1,"method":"state.unsubscribe","params":{"subscription":1}}'
    ),
    "no right": b'{"jsonrpc":"2.0","id":1,"method":"arm"}',
    "good": b'{"jsonrpc":"2.0","id":1,"method":"why"}',
}


@pytest.mark.parametrize("line", GRIEVANCES.values(), ids=GRIEVANCES.keys())
def test_no_request_leaves_work_for_the_garbage_collector(idle_api, line):
    """It runs once a minute in the daemon: what it alone can free grows until then."""
    reader = a_reader(idle_api.start(SessionLimits(rate_per_s=10_000, burst=300), NO_ONE))
    gc.collect()
    gc.disable()
    try:
        for _ in range(200):
            reader.send(line + b"\n")
            reader.line()
        assert gc.collect() < 100
    finally:
        gc.enable()


# Stopping is always possible.

WRONG_STOPS = [
    (b'{"jsonrpc":"2.0","id":5,"method":"estop","params":[]}', 5, "params must be an object"),
    (b'{"jsonrpc":"2.0","id":null,"method":"estop"}', None, "id must be a string"),
    (b'{"id":"a","method":"estop"}', "a", 'jsonrpc must be "2.0"'),
    (b'{"jsonrpc":"2.0","method":"estop","params":[]}', None, "params must be an object"),
    (b'{"jsonrpc":"2.0","id":5,"id":5,"method":"estop"}', None, "duplicate key"),
]


@pytest.mark.parametrize(("line", "request_id", "sentence"), WRONG_STOPS)
@pytest.mark.parametrize("stop", ["estop", "disarm"])
def test_a_stop_wrong_in_form_is_done_and_the_answer_says_what_was_wrong(
    idle_api, line, request_id, sentence, stop
):
    """Also for those who may only read: whoever reaches the socket may stop the vehicle."""
    reader = a_reader(idle_api.start(policy=NO_ONE))
    reader.send(line.replace(b"estop", stop.encode()) + b"\n")
    eventually(lambda: idle_api.service.held)
    ((method, params, _),) = idle_api.service.begun
    assert (method, params) == (stop, Nothing())
    assert not reader.has_news(), "the answer waits until it is done"
    idle_api.service.release()
    answer = reader.line()
    assert answer["id"] == request_id
    assert sentence in answer["error"]["message"]
    assert answer["error"]["message"].endswith("; done all the same")
    assert idle_api.counts()["stopped_anyway"] == 1
    assert sum(idle_api.counts()["errors"].values()) == 1
    assert reader.ask("why", 6)


def test_a_stop_wrong_in_form_that_cannot_be_done_is_not_reported_as_done(api, client):
    client.send(b'{"method":"estop"}\n')
    eventually(lambda: api.service.held)
    api.service.release(RequestError(ErrorCode.NOT_READY, "the gateway is ending"))
    assert client.line()["error"]["message"].endswith("; not done: the gateway is ending")


# Rights.


def test_who_may_only_read_is_told_which_right_is_missing(idle_api):
    reader = a_reader(idle_api.start(policy=NO_ONE))
    for request in ("arm", "demand.set"):
        params = DEMAND if request == "demand.set" else {}
        error = reader.ask(request, **params)
        assert error["code"] == ErrorCode.NO_RIGHT.value
        assert f"{request} needs the right 'operate', which user" in error["message"]
    assert "right 'service'" in reader.ask("config.reload")["message"]
    assert "reset at service level needs" in reader.ask("reset", level="service")["message"]
    assert idle_api.service.begun == []
    refused = idle_api.service.calls_of("log_refused")
    assert [method for method, _ in refused] == ["arm", "demand.set", "config.reload", "reset"]


def test_a_refused_notification_is_logged_but_not_answered(idle_api):
    reader = a_reader(idle_api.start(policy=NO_ONE))
    reader.notify("arm")
    assert reader.ask("why")["answer"] == "why"
    assert idle_api.service.calls_of("log_refused")


@pytest.mark.parametrize("method", ["estop", "disarm", "state.get", "why"])
def test_whoever_reaches_the_socket_may_read_and_stop_the_vehicle(idle_api, method):
    reader = a_reader(idle_api.start(policy=NO_ONE))
    reader.request(method)
    eventually(lambda: idle_api.service.begun)


def test_a_group_may_be_given_the_right_to_operate(idle_api):
    policy = NO_ONE._replace(operator_gids=frozenset({os.getegid()}))
    operator = a_reader(idle_api.start(policy=policy))
    operator.request("arm")
    eventually(lambda: idle_api.service.begun)
    assert "right 'service'" in operator.ask("config.reload")["message"]
    for request in ("reset", "drive_mode.set"):
        params = {"level": "service"} | ({} if request == "reset" else {"mode": "eco"})
        message = operator.ask(request, **params)["message"]
        assert f"{request} at service level needs the right 'service'" in message
    operator.request("reset", level="driver")
    eventually(lambda: len(idle_api.service.begun) == 2)


# The end of a connection.


def test_a_demand_ends_with_the_connection_that_made_it(api, client):
    assert client.ask("why")
    client.close()
    eventually(lambda: api.service.calls_of("end_demands"))
    eventually(lambda: api.counts()["clients"] == 0)
    assert len(api.service.calls_of("end_demands")) == 1
    assert api.service.calls_of("log_closed") == []


def test_the_demand_ends_while_answers_still_wait(api, client):
    client.request("arm")
    eventually(lambda: api.service.held)
    client.half_close()
    eventually(lambda: api.service.calls_of("end_demands"))
    assert api.counts()["clients"] == 1
    api.service.release()
    assert client.line()["result"]["granted"]
    assert client.line() is None
    assert len(api.service.calls_of("end_demands")) == 1


def test_the_demand_ends_while_the_reader_stands_still(api, client):
    api.service.filler = BIG
    client.request("state.get")
    client.request("demand.set", **DEMAND)
    eventually(lambda: api.service.begun)
    client.half_close()
    eventually(lambda: api.service.calls_of("end_demands"))
    assert len(client.rest()) > len(BIG)


def test_the_demand_ends_while_requests_wait_for_their_turn(idle_api):
    idle_api.start(SessionLimits(rate_per_s=1, burst=1))
    client, begin_ns = idle_api.connect(), time.monotonic_ns()
    client.send(b'{"jsonrpc":"2.0","method":"why"}\n' * 1000)
    client.close()
    eventually(lambda: idle_api.service.calls_of("end_demands"))
    eventually(lambda: idle_api.counts()["clients"] == 0)
    passed_s = (time.monotonic_ns() - begin_ns) // (1000 * MS)
    assert len(idle_api.service.begun) <= 1 + passed_s, "one a second had its turn"


def test_what_was_sent_before_the_end_is_answered(api, client):
    for number in range(30):
        client.request("why", number)
    client.half_close()
    assert [client.line()["id"] for _ in range(30)] == list(range(30))
    assert client.line() is None
    assert api.service.calls_of("log_closed") == []


def test_an_emergency_stop_counts_even_if_its_sender_left_at_once(api):
    for _ in range(20):
        client = api.connect()
        client.notify("estop")
        client.close()
    eventually(lambda: len(api.service.begun) == 20)
    eventually(lambda: len(api.service.calls_of("end_demands")) == 20)


def test_all_that_a_peer_sent_before_it_left_is_carried_out(api):
    """Up to its limits: nobody would hear what became of the rest."""
    client = api.connect()
    client.send(b'{"jsonrpc":"2.0","method":"why"}\n' * 40)
    client.close()
    eventually(lambda: len(api.service.begun) == 40)
    eventually(lambda: api.counts()["clients"] == 0)


def test_waiting_for_an_answer_of_a_half_closed_connection_costs_nothing(api, client):
    client.ask("state.subscribe", rate_hz=50)
    client.request("arm", 2)
    client.half_close()
    eventually(lambda: api.service.calls_of("end_demands"))
    ended_ns, before_ns = time.monotonic_ns(), time.process_time_ns()
    time.sleep(0.3)
    assert time.process_time_ns() - before_ns < 50 * MS
    api.service.release()
    messages = [json.loads(line) for line in client.rest().splitlines()]
    assert messages[-1]["id"] == 2
    states = [message["params"]["state"] for message in messages[:-1]]
    assert all(state["monotonic_ns"] < ended_ns for state in states)


def test_no_demand_comes_from_a_connection_that_has_ended(api):
    """The order of the calls matters: nobody would end a demand made after `end_demands`."""
    for _ in range(50):
        client = api.connect()
        client.request("demand.set", **DEMAND)
        client.half_close()
        eventually(lambda: api.service.held or client.has_news())  # noqa: B023
        was_taken = bool(api.service.held)
        api.service.release()
        assert was_taken or b"this connection has ended" in client.rest()
    eventually(lambda: len(api.service.calls_of("end_demands")) == 50)
    ended = set()
    for method, connection, *_ in api.service.calls:
        assert method == "end_demands" or connection not in ended
        ended |= {connection} if method == "end_demands" else set()


def test_a_last_line_without_its_newline_counts_when_the_sender_is_done(client):
    client.send(b'{"jsonrpc":"2.0","id":1,"method":"why"}')
    client.half_close()
    assert client.line()["result"]["answer"] == "why"


def test_a_peer_that_dies_with_answers_unread_costs_only_its_connection(api):
    for _ in range(10):
        client = api.connect()
        for _ in range(20):
            client.request("state.get")
        client.close()
    eventually(lambda: len(api.service.calls_of("end_demands")) == 10)
    eventually(lambda: api.counts()["clients"] == 0)
    assert api.connect().ask("why")


def test_a_peer_that_only_stops_reading_is_let_go(api, client):
    client.sock.shutdown(socket.SHUT_RD)
    client.request("why")
    eventually(lambda: len(api.service.calls_of("end_demands")) == 1)
    eventually(lambda: api.counts()["clients"] == 0)


# What one connection may cost.


def test_a_line_longer_than_64_kib_costs_its_sender_the_connection(api, client):
    client.send(b"a" * 65_537)
    assert "at most 65536 bytes" in client.line()["error"]["message"]
    assert client.line() is None
    eventually(lambda: api.service.calls_of("log_closed") == [("line too long",)])
    assert api.counts()["closed"] == {"line too long": 1}
    assert api.counts()["errors"] == {"parse_error": 1}


def test_a_line_of_100_mb_is_not_read(api, client):
    block, sent = b"[" * 1_000_000, 0
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with contextlib.suppress(OSError):
        while sent < 100_000_000:
            sent += client.sock.send(block)
    assert sent < 2_000_000
    after_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after_kib - before_kib < 8192
    assert api.connect().ask("why")


def test_a_line_that_is_not_finished_in_time_costs_the_connection(idle_api):
    client = idle_api.start(SHORT).connect()
    client.send(b"{")
    assert client.line() is None
    assert idle_api.counts()["closed"] == {"line not finished in time": 1}


def test_one_byte_now_and_then_does_not_keep_a_connection(idle_api):
    client = idle_api.start(SHORT).connect()
    end_s = time.monotonic() + PATIENCE_S
    while not client.is_ended():
        assert time.monotonic() < end_s
        try:
            client.send(b" ")
        except OSError:
            break
        time.sleep(0.01)
    assert idle_api.counts()["closed"] == {"line not finished in time": 1}


def test_a_silent_connection_may_stay(idle_api):
    client = idle_api.start(LONGER).connect()
    other = idle_api.connect()
    assert client.ask("why")
    other.send(b"{")
    assert other.line() is None  # the patience is over by now
    line = b'{"jsonrpc":"2.0","id":1,"method":"why"}\n'
    client.send(line[:20])
    time.sleep(0.02)
    client.send(line[20:])
    assert client.line()["result"]


def test_a_reader_that_stands_still_costs_its_connection(idle_api):
    idle_api.service.filler = BIG
    idle_api.start(SHORT._replace(output_bytes=10**7))
    client = idle_api.connect()
    client.request("state.get")
    eventually(lambda: idle_api.service.calls_of("log_closed") == [("reader stands still",)])
    assert 0 < len(client.rest()) < len(BIG)


def test_a_reader_that_reads_on_slowly_keeps_its_connection(idle_api):
    idle_api.service.filler = BIG * 20
    idle_api.start(LONGER._replace(output_bytes=10**7))
    client = idle_api.connect()
    begin_ns = time.monotonic_ns()
    client.request("state.get")
    client.send(b'{"jsonrpc":"2.0","id":2,"me')  # nor is this counted as late: it was not read
    data = b""
    while not data.endswith(b"\n"):
        data += client.sock.recv(65536)
        time.sleep(0.02)
    assert time.monotonic_ns() - begin_ns > 2200 * MS, "longer than the patience"
    assert len(data) > len(BIG) * 20
    client.send(b'thod":"arm"}\n')
    eventually(lambda: idle_api.service.held)


def test_more_output_than_may_wait_costs_the_connection(idle_api):
    idle_api.service.filler = "x" * 800_000
    client = idle_api.start().connect()
    client.request("state.get")
    eventually(lambda: idle_api.service.calls_of("log_closed") == [("too much output waits",)])


def test_while_answers_wait_to_be_read_no_request_is(api, client):
    api.service.filler = BIG[:200_000]
    for number in range(8):
        client.request("state.get", number)
    eventually(lambda: len(api.service.begun) >= 2)
    time.sleep(0.1)  # nothing is judged by this: it gives a mistake the time to show
    assert len(api.service.begun) <= 3
    assert [client.line()["id"] for _ in range(8)] == list(range(8))


def test_sixteen_requests_of_a_connection_wait_and_the_next_is_not_read(api, client):
    for number in range(20):
        client.request("arm", number)
    eventually(lambda: len(api.service.held) == 16)
    assert api.connect().ask("why")
    assert len(api.service.held) == 16
    api.service.release()
    eventually(lambda: len(api.service.held) == 4)
    api.service.release()
    assert [client.line()["id"] for _ in range(20)] == list(range(20))


@pytest.mark.parametrize("is_notified", [False, True])
def test_waiting_for_answers_is_not_counted_as_a_late_line(idle_api, is_notified):
    client = idle_api.start(LONGER).connect()
    for number in range(16):
        if is_notified:
            client.notify("arm")
        else:
            client.request("arm", number)
    line = b'{"jsonrpc":"2.0","id":16,"method":"why"}\n'
    client.send(line[:10])
    eventually(lambda: len(idle_api.service.held) == 16)
    time.sleep(1.7)  # longer than its patience
    idle_api.service.release()
    time.sleep(0.02)
    client.send(line[10:])
    first = 16 if is_notified else 0
    assert [client.line()["id"] for _ in range(first, 17)] == list(range(first, 17))


def test_waiting_for_a_client_costs_nothing(api, client):
    for number in range(40):
        client.request("arm", number)
    other = api.connect()
    api.service.filler = BIG[:200_000]
    for _ in range(8):
        other.request("state.get")
    eventually(lambda: len(api.service.held) == 16)
    eventually(other.has_news)
    before_ns = time.process_time_ns()
    time.sleep(0.3)
    assert time.process_time_ns() - before_ns < 50 * MS


def test_the_limits_are_those_of_the_documentation():
    assert SessionLimits() == SessionLimits(
        clients=16,
        reserved_clients=4,
        rate_per_s=200,
        burst=50,
        pending_requests=16,
        output_bytes=262_144,
        timeout_ns=10_000 * MS,
        accept_pause_ns=1_000 * MS,
        linger_ns=300 * MS,
    )


def test_too_many_requests_wait_and_are_answered_later(idle_api):
    idle_api.start(SessionLimits(rate_per_s=2, burst=10))
    client = idle_api.connect()
    begin_ns = time.monotonic_ns()
    for number in range(12):
        client.request("why", number)
    assert [client.line()["id"] for _ in range(12)] == list(range(12))
    assert time.monotonic_ns() - begin_ns >= 1000 * MS
    assert idle_api.counts()["closed"] == {}


def test_a_flood_on_one_connection_does_not_hold_up_another(api, client):
    api.service.filler = "x" * 1000
    stop = threading.Event()
    flooding = api.connect()
    reading = threading.Thread(target=flooding.rest)
    reading.start()

    def flood() -> None:
        while not stop.is_set():
            flooding.notify("nonsense")
        flooding.half_close()

    thread = threading.Thread(target=flood)
    thread.start()
    for number in range(20):
        assert client.ask("why", number)
    stop.set()
    thread.join()
    reading.join()


def test_a_driver_is_served_between_all_the_others(idle_api):
    """A flood of others must not use up a demand's time to live."""
    api, server = idle_api, idle_api.make()
    server.open()
    driver, others = api.connect(), [api.connect() for _ in range(8)]
    for sequence in range(10):
        driver.request("demand.set", sequence, source="driver", sequence=sequence, values={})
        for other in others:
            other.request("why", sequence)
    server.start()
    eventually(lambda: len(api.service.begun) == 90)
    order = [method for method, _, _ in api.service.begun]
    last = max(index for index, method in enumerate(order) if method == "demand.set")
    assert last < 40, "turn by turn it would be among the last"


# Places.


def connected(api, count: int) -> list[Client]:
    """So many connections, each with a place, the first idle for longest."""
    clients = [api.connect() for _ in range(count)]
    assert all(client.ask("why") for client in clients)
    return clients


def number_of(api, client: Client) -> int:
    """The gateway's number of this connection, which asks for something to be found."""
    client.ask("health")
    return api.service.begun[-1][2].connection


def test_where_sixteen_are_in_the_longest_idle_gives_way_and_the_next_is_served(api):
    clients = connected(api, 16)
    assert clients[0].ask("why")  # now the second is idle for longest
    assert api.connect().ask("why")
    assert clients[1].line() is None
    assert not any(client.has_news() for client in [clients[0], *clients[2:]])
    counts = api.counts()
    assert (counts["clients"], counts["gave_way"], counts["turned_away"]) == (16, 1, 0)
    assert counts["closed"] == {EVICTED: 1}
    assert api.service.calls_of("log_closed") == [(EVICTED,)]
    assert len(api.service.calls_of("end_demands")) == 1


@pytest.mark.parametrize("attempt", range(10))
def test_sixteen_idle_connections_shut_nobody_out_of_an_emergency_stop(idle_api, attempt):
    idle_api.start(policy=NO_ONE)
    for _ in range(16):  # that many readers have 12 places
        a_reader(idle_api)
    stopping = a_reader(idle_api)
    stopping.request("estop")
    eventually(lambda: idle_api.service.begun)
    idle_api.service.release()
    assert stopping.line()["result"]["granted"]


def test_who_reads_a_subscription_is_not_idle(api):
    watching, *others = connected(api, 16)
    watching.ask("state.subscribe", rate_hz=50)
    assert [watching.line()["method"] for _ in range(3)] == ["state.update"] * 3
    assert api.connect().ask("why")
    assert others[0].line() is None
    assert watching.line()["method"] == "state.update"


def test_the_owner_of_a_fresh_demand_keeps_its_place_however_idle(api):
    owner, *others = connected(api, 16)
    api.service.demand_of = {number_of(api, owner)}
    for other in others:
        assert other.ask("why")
    for _ in range(20):
        api.connect()
    eventually(lambda: api.counts()["gave_way"] == 20)
    assert owner.ask("why")


def test_where_every_place_has_a_demand_the_next_is_told_why_not(idle_api):
    api = idle_api.start(SessionLimits(clients=2, reserved_clients=0))
    clients = connected(api, 2)
    api.service.demand_of = {number_of(api, client) for client in clients}
    extra = api.connect()
    error = extra.line()["error"]
    assert error["code"] == ErrorCode.TOO_MANY_CLIENTS.value
    assert "2 clients at most" in error["message"]
    assert "a demand keeps its place" in error["message"]
    assert extra.line() is None
    counts = api.counts()
    assert (counts["clients"], counts["turned_away"], counts["gave_way"]) == (2, 1, 0)
    clients.pop().close()
    eventually(lambda: api.counts()["clients"] == 1)
    assert api.connect().ask("why")


def test_what_a_connection_asked_for_before_it_gives_way_is_done(idle_api):
    """A flood of connections between an emergency stop and its turn does not lose it."""
    server = idle_api.make(SessionLimits(clients=1, reserved_clients=0))
    server.open()
    stopping = idle_api.connect()
    for _ in range(20):
        stopping.notify("why")
    stopping.request("estop")
    others = [idle_api.connect() for _ in range(8)]
    server.start()
    assert others[-1].ask("why")
    assert "estop" in [method for method, _, _ in idle_api.service.begun]


def many(api, count: int, uid: int) -> list[Client]:
    """So many readers of this user, the first idle for longest."""
    readers = []
    for _ in range(count):
        with a_stranger(uid):
            readers.append(api.connect())
        assert readers[-1].ask("why")
    return readers


NEEDS_USERS = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be several users")


@NEEDS_USERS
def test_of_two_users_the_one_with_most_of_the_places_gives_way_to_itself(idle_api):
    idle_api.start(policy=NO_ONE)
    few, most = many(idle_api, 3, NOBODY), many(idle_api, 9, NOBODY - 2)
    many(idle_api, 1, NOBODY - 2)
    assert most[0].line() is None
    many(idle_api, 1, NOBODY)
    assert few[0].line() is None, "the longest idle of all, for a user with few places"
    many(idle_api, 30, NOBODY - 2)
    assert idle_api.counts()["gave_way"] == 32
    assert all(client.ask("why") for client in few[1:])


@NEEDS_USERS
def test_four_places_are_kept_from_those_who_only_read(idle_api):
    idle_api.start(policy=NO_ONE._replace(own_uid=0))
    ours = connected(idle_api, 4)
    readers = many(idle_api, 12, NOBODY)
    many(idle_api, 1, NOBODY - 2)  # the longest idle are ours, and not for a reader's sake
    assert readers[0].line() is None
    assert idle_api.counts()["clients"] == 16
    assert all(client.ask("why") for client in ours)
    many(idle_api, 5, NOBODY - 2)
    assert idle_api.counts()["clients"] == 16
    assert all(client.ask("why") for client in ours)


@pytest.mark.parametrize(
    ("policy", "clients", "readers", "is_in"),
    [
        (NO_ONE, 11, 11, True),
        (NO_ONE, 12, 12, False),
        (NO_ONE, 15, 11, True),
        (NO_ONE, 16, 11, False),
        (EVERYONE, 15, 12, True),
        (EVERYONE, 16, 12, False),
    ],
)
def test_a_place_depends_on_who_is_in_and_what_one_may(folder, policy, clients, readers, is_in):
    with socket.socket(socket.AF_UNIX) as listener, socket.socket(socket.AF_UNIX) as client:
        path = os.fspath(folder / "s")
        listener.bind(path)
        os.chmod(path, 0o666)
        listener.listen()
        with a_stranger() if policy is NO_ONE else open(os.devnull):
            client.connect(path)
        acceptor = Acceptor(listener, ServerSettings(folder / "s", policy), Counters())
        session = acceptor.session(acceptor.next_socket(0), 0)
        assert acceptor.has_place(session.caller, clients, readers, lambda *_: False) is is_in
        session.sock.close()


def test_ten_thousand_connects_leave_nothing_behind(idle_api):
    idle_api.start()
    client = idle_api.connect()
    assert client.ask("why")
    files = len(os.listdir("/proc/self/fd"))
    for _ in range(10_000):
        with socket.socket(socket.AF_UNIX) as sock:
            sock.connect(os.fspath(idle_api.path))
    counts = idle_api.counts
    eventually(lambda: counts()["accepted"] + counts()["turned_away"] == 10_001)
    eventually(lambda: counts()["clients"] == 1)
    eventually(lambda: len(os.listdir("/proc/self/fd")) <= files)
    assert client.ask("why")


def test_without_descriptors_accepting_pauses_and_goes_on(idle_api):
    idle_api.start(SessionLimits(accept_pause_ns=200 * MS))
    first = idle_api.connect()
    assert first.ask("why")
    gc.collect()  # what it closed later would make room
    spare = socket.socket(socket.AF_UNIX)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(int(fd) for fd in os.listdir("/proc/self/fd"))
    fillers = [os.dup(0) for _ in range(3)]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(highest + 1, *fillers), hard))
    try:
        free = []
        try:
            while True:
                free.append(os.dup(0))
        except OSError:
            pass
        spare.connect(os.fspath(idle_api.path))
        cpu_ns = time.process_time_ns()
        assert first.ask("why")
        time.sleep(0.3)
        assert first.ask("why")
        assert time.process_time_ns() - cpu_ns < 100 * MS  # it does not spin
        assert idle_api.counts()["accepted"] == 1
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for fd in free + fillers:
            os.close(fd)
    client = Client(spare)
    assert client.ask("why")
    client.close()


# Subscriptions.


def test_a_subscription_is_answered_and_updates_follow(client):
    begin_ns, lost = time.monotonic_ns(), 0
    answer = client.ask("state.subscribe", messages=["IMU"], rate_hz=50)
    assert answer["rate_hz"] == 50
    for number in range(3):
        update = client.line()
        assert (update["jsonrpc"], update["method"]) == ("2.0", "state.update")
        assert update["params"]["subscription"] == answer["subscription"]
        lost += update["params"]["lost"]
        due = 1 + (time.monotonic_ns() - begin_ns) // (20 * MS)
        assert number + 1 + lost <= due, "none is lost but to a machine that stands still"
        assert update["params"]["state"]["messages"] == ["IMU"]


def test_updates_keep_to_their_grid():
    subscription = SubscriptionState(1, None, rate_hz=50, due_ns=7)
    assert subscription.due_ns == 7
    assert subscription.advance(7) == 1
    assert subscription.advance(7 + 20 * MS + 19 * MS) == 1
    assert subscription.due_ns == 7 + 40 * MS
    assert subscription.advance(7 + 101 * MS) == 4
    assert subscription.due_ns == 7 + 120 * MS


def test_a_message_that_does_not_exist_is_refused_at_subscribing(api, client):
    error = client.ask("state.subscribe", messages=["IMUU"])
    assert "no message 'IMUU'" in error["message"]
    assert client.ask("why")["answer"] == "why"


def test_four_subscriptions_are_the_most(client):
    numbers = [client.ask("state.subscribe", rate_hz=0.1)["subscription"]]
    client.line()
    for _ in range(3):
        numbers.append(client.ask("state.subscribe", rate_hz=0.1)["subscription"])
        client.line()
    assert "4 subscriptions are the most" in client.ask("state.subscribe")["message"]
    assert client.ask("state.unsubscribe", subscription=numbers[0])["subscription"] == numbers[0]
    assert client.ask("state.subscribe", rate_hz=0.1)["subscription"] not in numbers


def test_an_ended_subscription_sends_no_more(client):
    number = client.ask("state.subscribe", rate_hz=50)["subscription"]
    client.request("state.unsubscribe", 9, subscription=number)
    while client.line().get("id") != 9:
        pass
    assert client.ask("why")["answer"] == "why"
    client.half_close()
    assert client.rest() == b""


@pytest.mark.parametrize("number", [0, -1, 2**63])
def test_a_subscription_of_nobody_cannot_be_ended(api, client, number):
    other = api.connect()
    other.ask("state.subscribe", rate_hz=0.1)
    assert "has no subscription" in client.ask("state.unsubscribe", subscription=number)["message"]


def test_a_slow_reader_loses_updates_and_is_told_how_many(api, client):
    api.service.filler = BIG[:150_000]
    client.ask("state.subscribe", rate_hz=50)
    eventually(lambda: api.counts()["lost_updates"] >= 10)
    lost, updates = 0, 0
    while lost < 10:
        update = client.line()["params"]
        updates += 1
        lost += update["lost"]
        assert updates < 8
    eventually(lambda: client.line()["params"]["lost"] == 0)
    assert api.counts()["closed"] == {}


def test_subscriptions_end_with_a_half_closed_connection(client):
    client.request("state.subscribe", rate_hz=50)
    client.half_close()
    messages = client.rest()
    assert messages.startswith(b'{"jsonrpc":"2.0","id":1,')


def test_many_subscriptions_leave_room_for_requests(api):
    api.service.filler = "x" * 2000
    subscribers = [api.connect() for _ in range(15)]
    readers = [threading.Thread(target=client.rest) for client in subscribers]
    for subscriber, reader in zip(subscribers, readers, strict=True):
        for number in range(4):
            subscriber.request("state.subscribe", number, messages=list(KNOWN), rate_hz=50)
        reader.start()
    client = api.connect()
    assert all(client.ask("why", number) for number in range(20))
    for subscriber in subscribers:
        subscriber.half_close()
    for reader in readers:
        reader.join()


# Between the ticks.


@pytest.mark.clock
def test_the_api_works_in_the_gaps_between_the_ticks(idle_api):
    """Updates that are due with every tick are made after it: the state is made when it is sent."""
    origin_ns, period_ns = time.monotonic_ns(), 50 * MS

    class Loop:
        """Its thread takes each tick at once."""

        @property
        def schedule(self):
            ticks = (time.monotonic_ns() - origin_ns) // period_ns + 1
            return SimpleNamespace(
                period_ns=period_ns, next_deadline_ns=origin_ns + ticks * period_ns
            )

    idle_api.start(gaps=TickGaps(Loop()))
    client = idle_api.connect()
    client.ask("state.subscribe", rate_hz=20)
    origin_ns = client.line()["params"]["state"]["monotonic_ns"]
    client.line()
    stamps_ns = [client.line()["params"]["state"]["monotonic_ns"] for _ in range(10)]
    # A machine that stands still between the look at the clock and the stamp moves one anywhere.
    in_the_gap = [0.9 * MS < (stamp - origin_ns) % period_ns < 48.5 * MS for stamp in stamps_ns]
    assert sum(in_the_gap) >= 8, "each would be made right at its tick"


# Starting and ending.

PATIENT_END = SessionLimits(linger_ns=round(PATIENCE_S * 1000) * MS)


def test_closing_answers_what_is_pending_and_removes_the_socket(idle_api):
    api = idle_api.start(PATIENT_END)
    client = api.connect()
    client.request("arm")
    eventually(lambda: api.service.held)
    closing = threading.Thread(target=api.server.close)
    closing.start()
    eventually(lambda: not api.path.exists())
    api.service.release()
    closing.join()
    assert client.line()["result"]["granted"]
    assert client.line() is None
    assert len(api.service.calls_of("end_demands")) == 1
    assert api.server.failed is None


def test_closing_lets_a_reader_read_on(idle_api):
    idle_api.service.filler = BIG
    client = idle_api.start(PATIENT_END._replace(output_bytes=10**7)).connect()
    client.request("state.get")
    eventually(client.has_news)
    closing = threading.Thread(target=idle_api.server.close)
    closing.start()
    eventually(lambda: not idle_api.path.exists())
    assert client.line()["result"]["filler"] == BIG
    closing.join()


def test_closing_waits_for_a_short_while_only(idle_api):
    client = idle_api.start(SessionLimits(linger_ns=50 * MS)).connect()
    client.request("arm")
    eventually(lambda: idle_api.service.held)
    begin_ns = time.monotonic_ns()
    idle_api.server.close()
    assert time.monotonic_ns() - begin_ns < 2000 * MS
    assert client.line()["error"]["code"] == ErrorCode.NOT_READY.value
    assert client.line() is None
    idle_api.service.release()  # late, and nobody is hurt


def test_who_waits_in_the_backlog_is_served_after_the_start(idle_api):
    server = idle_api.make()
    server.open()
    client = idle_api.connect()
    client.request("why")
    server.start()
    assert client.line()["result"]


def test_closing_twice_or_without_a_start_is_harmless(idle_api):
    idle_api.make().close()
    server = idle_api.make()
    server.open()
    server.close()
    server.close()
    assert not idle_api.path.exists()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bug_ends_the_api_and_not_the_program(api, client):
    other = api.connect()
    assert other.ask("why")
    api.service.bug = ZeroDivisionError("a bug")
    client.request("why")
    assert client.line() is None
    assert other.line() is None
    eventually(lambda: api.server.failed)
    assert "ZeroDivisionError('a bug')" in api.server.failed
    assert len(api.service.calls_of("end_demands")) == 2
    eventually(lambda: not api.path.exists())
    api.server.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bug_at_the_end_of_a_connection_ends_the_others_too(api, client):
    others = [api.connect() for _ in range(3)]
    assert all(other.ask("why") for other in others)
    api.service.bug_at_end = ZeroDivisionError("a bug")
    client.close()
    eventually(lambda: api.server.failed)
    assert "ZeroDivisionError" in api.server.failed
    assert [other.line() for other in others] == [None] * 3


def test_a_server_that_runs_or_has_ended_well_has_not_failed(api, client):
    assert client.ask("why")
    assert api.server.failed is None
    api.server.close()
    assert api.server.failed is None


def test_an_idle_server_does_not_wake_up(api, client):
    assert client.ask("why")
    before = time.process_time_ns()
    time.sleep(0.3)
    assert time.process_time_ns() - before < 20 * MS
