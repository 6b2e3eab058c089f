"""`estop` and `disarm` pass over what waits, and what they overtake is refused."""

from collections import deque
from collections.abc import Callable
from typing import Any

import pytest

from tests.server.attack import line
from tests.server.conftest import eventually
from vcu_gateway.api.errors import Peer
from vcu_gateway.server.dispatch import SharedRequest
from vcu_gateway.server.service import Caller, SessionLimits
from vcu_gateway.server.session import LineBuffer

SLOW = SessionLimits(rate_per_s=1, burst=1)
"""One request is served, and the next a second later: whatever comes before passes it over."""


# Which lines may name a stop.


def marked(buffer: LineBuffer) -> list[bytes]:
    """All that it names."""
    lines = []
    while (one := buffer.next_marked()) is not None:
        lines.append(one)
    return lines


@pytest.mark.parametrize("word", [b"estop", b"disarm", b"\\u0065stop"])
def test_a_line_that_may_name_a_stop_is_found_once_among_others(word):
    buffer = LineBuffer()
    buffer.feed(b"a\n" + b"x" * 99 + word + b"y\nb\n")
    assert marked(buffer) == [b"x" * 99 + word + b"y"]
    assert marked(buffer) == []


def test_a_line_is_found_when_it_is_whole_however_it_is_cut():
    text = b'why\n{"method":"estop"}\nwhy\n'
    for cut in range(1, len(text)):
        buffer, found = LineBuffer(), []
        for chunk in (text[:cut], text[cut:]):
            buffer.feed(chunk)
            found += marked(buffer)
        assert found == [b'{"method":"estop"}'], cut


def test_several_are_found_in_their_order_also_behind_one_that_was_taken():
    buffer = LineBuffer()
    buffer.feed(b"a\n1 estop\nb\n2 disarm\n3 estop\n")
    assert buffer.next_marked() == b"1 estop"
    buffer.take_marked()
    assert marked(buffer) == [b"2 disarm", b"3 estop"]
    assert [buffer.take() for _ in range(4)] == [b"a", b"b", b"2 disarm", b"3 estop"]
    assert not buffer.has_line


def test_the_first_line_can_be_taken_and_the_next_one_is_found():
    buffer = LineBuffer()
    buffer.feed(b"estop\na\n")
    assert buffer.next_marked() == b"estop"
    buffer.take_marked()
    assert buffer.take() == b"a"
    buffer.feed(b"disarm\n")
    assert marked(buffer) == [b"disarm"]


def test_what_is_taken_in_its_turn_is_not_found_any_more():
    buffer = LineBuffer()
    buffer.feed(b"a\nestop\n")
    assert [buffer.take(), buffer.take()] == [b"a", b"estop"]
    assert marked(buffer) == []


def test_what_waits_and_what_is_not_read_yet_is_overtaken_and_nothing_later():
    buffer = LineBuffer()
    buffer.feed(b"a\nb")
    buffer.overtake(len(b"c\nd\n"))
    buffer.feed(b"c\nd\ne\n")
    seen = []
    while buffer.has_line:
        seen.append((buffer.is_overtaken, buffer.take()))
    assert seen == [(True, b"a"), (True, b"bc"), (True, b"d"), (False, b"e")]


def test_the_end_of_the_stream_ends_the_last_line_also_behind_others():
    buffer = LineBuffer()
    buffer.feed(b"a\nestop")
    buffer.end()
    assert marked(buffer) == [b"estop"]
    buffer.end()
    assert [buffer.take(), buffer.take()] == [b"a", b"estop"]
    assert not buffer.is_partial


# On a connection.


def begun(api) -> list[str]:
    return [method for method, _, _ in api.service.begun]


@pytest.mark.parametrize("stop", ["estop", "disarm"])
def test_a_stop_passes_over_what_waits_before_it(idle_api, stop):
    idle_api.start(SLOW)
    client = idle_api.connect()
    client.send(line("why") * 300 + line(stop, 2))
    eventually(lambda: stop in begun(idle_api))
    assert begun(idle_api).index(stop) <= 1


def test_a_stop_cut_in_two_passes_over_what_waits(idle_api):
    idle_api.start(SLOW)
    client = idle_api.connect()
    text = line("why") * 30 + line("estop", 2)
    client.send(text[:-9])
    eventually(lambda: "why" in begun(idle_api))
    client.send(text[-9:])
    eventually(lambda: begun(idle_api) == ["why", "estop"])


def test_a_stop_wrong_in_form_passes_over_what_waits(idle_api):
    idle_api.start(SLOW)
    client = idle_api.connect()
    client.send(line("why") * 30 + b'{"method":"\\u0065stop","params":[]}\n')
    eventually(lambda: "estop" in begun(idle_api))
    assert idle_api.counts()["stopped_anyway"] == 1


@pytest.mark.parametrize("method", ["arm", "reset", "demand.set"])
@pytest.mark.parametrize("is_before", [True, False], ids=["before", "behind"])
def test_what_could_drive_again_is_refused_where_a_stop_overtook_it(idle_api, method, is_before):
    idle_api.start(SessionLimits(rate_per_s=20, burst=1))
    client = idle_api.connect()
    params = PARAMS.get(method, {})
    asked, stop = line(method, 7, **params), line("disarm", 8)
    client.send(line("why") * 2 + (asked + stop if is_before else stop + asked))
    answers = {answer["id"]: answer for answer in (client.line() for _ in range(3))}
    error = answers[7]["error"]
    assert error["data"] == {"word": "refused", "refusal": "overtaken"}
    assert method in error["message"]
    assert method not in begun(idle_api)
    client.request(method, 9, **params)
    eventually(lambda: method in begun(idle_api))


PARAMS: dict[str, dict[str, Any]] = {
    "reset": {"level": "driver"},
    "demand.set": {"source": "driver", "sequence": 1, "values": {}},
}


def test_what_only_reads_is_answered_although_a_stop_overtook_it(idle_api):
    idle_api.start(SessionLimits(rate_per_s=20, burst=1))
    client = idle_api.connect()
    client.send(line("why", 1) + line("health", 2) + line("estop", 3))
    assert [client.line()["id"] for _ in range(2)] == [1, 2]
    assert begun(idle_api).index("estop") <= 1


def test_another_connection_is_not_overtaken(idle_api):
    idle_api.start(SessionLimits(rate_per_s=20, burst=1))
    other, client = idle_api.connect(), idle_api.connect()
    other.send(line("why") + line("arm", 2))
    client.send(line("estop"))
    eventually(lambda: "arm" in begun(idle_api))


def test_a_stop_is_done_while_answers_wait_to_be_read(api, client):
    api.service.filler = "x" * 200_000
    client.send(line("state.get") * 2)
    eventually(lambda: len(begun(api)) == 2)
    client.request("estop", 2)
    eventually(lambda: "estop" in begun(api))
    assert not api.counts()["closed"]


def test_a_stop_is_done_while_sixteen_requests_wait_for_their_answer(api, client):
    client.send(line("arm") * 20 + line("estop", 2))
    eventually(lambda: "estop" in begun(api))


def test_stops_come_first_of_all_that_was_read_in_a_turn(idle_api):
    server = idle_api.make()
    server.open()
    clients = [idle_api.connect() for _ in range(10)]
    for client in clients[:9]:
        client.send(line("why") * 5)
    clients[9].send(line("estop"))
    server.start()
    eventually(lambda: len(begun(idle_api)) == 46)
    assert begun(idle_api)[0] == "estop"


def test_a_stop_needs_no_place(idle_api):
    server = idle_api.make(SessionLimits(clients=1, reserved_clients=0))
    server.open()
    idle_api.service.demand_of = range(10**9)  # whoever has a place keeps it
    owner, stopping = idle_api.connect(), idle_api.connect()
    owner.send(line("why"))
    stopping.send(line("estop"))
    server.start()
    assert stopping.line()["error"]["data"]["word"] == "too_many_clients"
    assert "estop" in begun(idle_api)
    assert owner.line()["result"]


def test_lines_that_only_mention_a_stop_wait_for_their_turn(idle_api):
    idle_api.start(SLOW)
    client = idle_api.connect()
    client.send(line("why", x="estop") * 100)
    client.send(line("estop", 2))
    eventually(lambda: "estop" in begun(idle_api))


# Stops that wait together.

FIRST, SECOND = (Caller(number, Peer(1, 0, frozenset()), frozenset()) for number in (1, 2))


def test_stops_that_wait_together_are_carried_out_once_and_all_are_answered():
    posted: deque[Callable[[], None]] = deque()
    executed: list[Caller] = []
    answers: list[Any] = []

    def execute(caller: Caller) -> dict[str, bool]:
        executed.append(caller)
        return {"granted": True}

    request = SharedRequest(execute, posted.append)
    for caller in (FIRST, SECOND, FIRST):
        request.ask(caller, answers.append)
    while posted:
        posted.popleft()()
    assert executed == [FIRST]
    assert answers == [{"granted": True}] * 3


def test_a_stop_that_is_asked_for_while_one_is_carried_out_is_carried_out_after_it():
    posted: deque[Callable[[], None]] = deque()
    executed: list[Caller] = []

    def execute(caller: Caller) -> dict[str, bool]:
        executed.append(caller)
        if caller == FIRST:
            request.ask(SECOND, lambda _: None)
        return {}

    request = SharedRequest(execute, posted.append)
    request.ask(FIRST, lambda _: None)
    while posted:
        posted.popleft()()
    assert executed == [FIRST, SECOND]
