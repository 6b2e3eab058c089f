"""Room for a stop: places of connections, costs of questions, merged calls, prepared samples."""

import asyncio
import json
from typing import Any

import pytest

from vcu_gateway.units import NS_PER_S
from vcu_gateway.web.connections import (
    MOST_CONNECTIONS,
    MOST_PER_ADDRESS,
    STOPS,
    STREAM,
    CostLimit,
    Place,
    gives_way,
)
from vcu_gateway.web.guard import HISTORY, QuestionLimit, cost_of
from vcu_gateway.web.history import PreparedSamples, Samples
from vcu_gateway.web.routes import MergedCall

# Places.


def full() -> list[Place]:
    """Every place taken, by as many addresses as it takes, the first idle for longest."""
    addresses = MOST_CONNECTIONS // MOST_PER_ADDRESS
    return [Place(f"10.0.0.{at % addresses}", float(at)) for at in range(MOST_CONNECTIONS)]


def test_where_there_is_room_nobody_gives_way():
    assert gives_way(full()[1:], "10.0.0.9") is None
    assert gives_way([], "10.0.0.9") is None


def test_where_all_places_are_taken_the_longest_idle_gives_way():
    places = full()
    assert gives_way(places, "10.0.0.9") is places[0]


def test_an_address_with_all_of_its_places_makes_room_among_its_own():
    places = full()[:-1]
    assert gives_way(places, "10.0.0.1") is places[1]


def test_whoever_has_signed_in_gives_way_after_those_who_have_not():
    places = full()
    for place in places[:-1]:
        place.has_session = True
    assert gives_way(places, "10.0.0.9") is places[-1]


def test_a_stream_gives_way_after_everything_else_of_those_who_have_signed_in():
    places = full()
    for place in places:
        place.has_session, place.path = True, STREAM
    places[7].path = "/api/history"
    assert gives_way(places, "10.0.0.9") is places[7]


@pytest.mark.parametrize("path", sorted(STOPS))
def test_a_connection_on_which_a_stop_is_asked_for_never_gives_way(path):
    places = full()
    for place in places:
        place.path = path
    assert gives_way(places, "10.0.0.9") is None
    places[3].path = ""
    assert gives_way(places, "10.0.0.9") is places[3]


def test_a_request_makes_its_connection_the_last_to_give_way():
    place = Place("10.0.0.1", 0.0)
    with place.asked("/"):
        assert place.path == "/"
    assert place.path == ""
    assert place.active_s > 0.0


def test_a_parked_connection_carries_out_a_stop_and_lets_all_else_wait():
    async def tried() -> list[str]:
        place, done = Place("10.0.0.1", 0.0), []
        place.is_parked = True

        async def ask(path: str) -> None:
            await place.wait_for(path)
            done.append(path)

        asked = [asyncio.create_task(ask(path)) for path in ("/", "/api/actions/estop")]
        for _ in range(5):
            await asyncio.sleep(0)
        done.append("a place")
        place.unpark()
        await asyncio.gather(*asked)
        return done

    assert asyncio.run(tried()) == ["/api/actions/estop", "a place", "/"]


# Costs.


def test_a_burst_is_free_then_one_after_the_other_and_each_key_has_its_own():
    limit = CostLimit(burst=3, per_s=10)
    for _ in range(3):
        assert limit.wait_ns("a", 1, 0) == 0
        limit.take("a", 1, 0)
    assert limit.wait_ns("a", 1, 0) == NS_PER_S // 10
    assert limit.wait_ns("b", 3, 0) == 0
    assert limit.wait_ns("a", 3, NS_PER_S) == 0


@pytest.mark.parametrize("path", ["/api/actions/estop", "/api/actions/disarm", "/api/session"])
def test_a_stop_and_signing_in_cost_no_question(path):
    assert cost_of("POST", path) == 0
    assert cost_of("GET", path) == 1


def test_samples_cost_more_than_a_file():
    assert cost_of("GET", HISTORY) > cost_of("GET", "/main.js") > 0


def refused_after(limit: QuestionLimit, address: str, cookie: str) -> int:
    """How many questions for samples are answered at one instant."""
    for number in range(1000):
        if limit.wait_ns(address, cookie, cost_of("GET", HISTORY), 0) > NS_PER_S:
            return number
    raise AssertionError("there is no limit")


def test_a_session_is_limited_and_another_of_the_same_address_is_not_yet():
    limit = QuestionLimit()
    assert refused_after(limit, "10.0.0.1", "vcu-session=a") == 12
    assert limit.wait_ns("10.0.0.1", "vcu-session=b", 20, 0) == 0


def test_an_address_is_limited_whatever_cookies_it_makes_up_and_others_are_not():
    limit = QuestionLimit()
    asked = 0
    while limit.wait_ns("10.0.0.1", f"x={asked}", 20, 0) <= NS_PER_S:
        asked += 1
    assert asked == 18
    assert limit.wait_ns("10.0.0.2", "x=1", 20, 0) == 0


# Merged calls.


def merged(begin: list[int]) -> tuple[list[str], list[str]]:
    """Calls that were made, and what each of those who asked was answered, by when they ask."""

    async def tried() -> tuple[list[str], list[str]]:
        calls: list[str] = []
        gate = asyncio.Event()

        async def call() -> str:
            calls.append(f"call {len(calls) + 1}")
            name = calls[-1]
            await gate.wait()
            return name

        shared = MergedCall(call)
        asked = []
        for count in begin:
            asked += [asyncio.create_task(shared()) for _ in range(count)]
            for _ in range(5):
                await asyncio.sleep(0)
        gate.set()
        return calls, await asyncio.gather(*asked)

    return asyncio.run(tried())


def test_those_who_ask_together_share_one_call():
    assert merged([5]) == (["call 1"], ["call 1"] * 5)


def test_whoever_asks_while_one_runs_has_one_that_began_after_he_asked():
    calls, answers = merged([1, 3, 2])
    assert calls == ["call 1", "call 2"]
    assert answers == ["call 1"] + ["call 2"] * 5


def test_whoever_leaves_ends_the_call_for_nobody_else():
    async def tried() -> str:
        gate = asyncio.Event()

        async def call() -> str:
            await gate.wait()
            return "done"

        shared = MergedCall(call)
        leaving, staying = asyncio.create_task(shared()), asyncio.create_task(shared())
        await asyncio.sleep(0)
        leaving.cancel()
        await asyncio.sleep(0)
        gate.set()
        return await staying

    assert asyncio.run(tried()) == "done"


# Prepared samples.


def test_samples_are_put_together_once_for_all_who_ask_within_a_second():
    read: list[Any] = []
    time_s = [0.0]

    def samples(names: tuple[str, ...], points: int) -> Any:
        read.append((names, points))
        return {"times_ms": [len(read)], "values": {}}

    async def tried() -> list[int]:
        prepared = PreparedSamples(samples, lambda: time_s[0])
        questions = [("a",), ("a",), ("b",), ("a",)]
        together = await asyncio.gather(*(prepared.encoded(names, 9) for names in questions))
        time_s[0] = 1.0
        later = await prepared.encoded(("a",), 9)
        return [json.loads(one.plain)["times_ms"][0] for one in (*together, later)]

    assert asyncio.run(tried()) == [1, 1, 2, 1, 3]
    assert read == [(("a",), 9), (("b",), 9), (("a",), 9)]


def test_no_more_than_sixteen_answers_are_kept():
    async def tried() -> int:
        none: Samples = {"times_ms": [], "values": {}}
        prepared = PreparedSamples(lambda *_: none)
        for points in range(100):
            await prepared.encoded(("a",), points)
        return len(prepared._kept)

    assert asyncio.run(tried()) == 16
