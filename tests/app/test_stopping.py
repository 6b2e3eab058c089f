"""Stopping is always possible: in any form that names it, and however many are connected."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.app.conftest import is_reset
from tests.driven import Driven
from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.client import ApiError
from vcu_gateway.core.causes import Event
from vcu_gateway.daemon import restart_state
from vcu_gateway.daemon.restart_state import RestartState, read

WRONG = {
    "an empty list of parameters": {"jsonrpc": "2.0", "id": 1, "params": []},
    "no version": {"id": 1},
    "an id that is null": {"jsonrpc": "2.0", "id": None},
    "no id, and an empty list": {"jsonrpc": "2.0", "params": []},
}


@pytest.fixture
def driving(running: Driven) -> Iterator[Driven]:
    """Active, with throttle, by a client of its own."""
    running.until_ready()
    with running.client() as client, client.demand("driver", hold_s=None) as owner:
        owner.set(throttle_pct=0)
        client.arm()
        owner.set(throttle_pct=30)
        running.until_mode("active")
        yield running
    if running.mode == "fault":
        running.until(lambda: running.latest_why.next_step == "service reset", "the hold's end")


def told(gateway: Driven, message: dict[str, Any]) -> dict[str, Any]:
    """The answer to one line of a connection of its own."""
    with socket.socket(socket.AF_UNIX) as one:
        one.settimeout(30)
        one.connect(str(gateway.socket_path))
        one.sendall(json.dumps(message).encode() + b"\n")
        return json.loads(one.makefile("r").readline())


@pytest.mark.clock
@pytest.mark.parametrize("form", WRONG.values(), ids=WRONG.keys())
@pytest.mark.parametrize(("stop", "mode"), [("estop", "fault"), ("disarm", "standby")])
def test_a_stop_wrong_in_form_stops_the_vehicle(driving: Driven, form, stop, mode):
    with driving.client() as client:
        before = client.health()["api"]["stopped_anyway"]
    answer = told(driving, {**form, "method": stop})
    assert answer["id"] == form.get("id")
    assert answer["error"]["message"].endswith("; done all the same")
    driving.until_mode(mode)
    with driving.client() as client:
        assert client.health()["api"]["stopped_anyway"] == before + 1


@pytest.mark.parametrize("form", [{"id": 1}, *WRONG.values()], ids=["right", *WRONG.keys()])
def test_an_emergency_stop_in_any_form_is_kept_before_it_is_answered(
    fresh: Driven, form, tmp_path, monkeypatch
):
    monkeypatch.setattr(restart_state, "_QUICK_NS", 10**12)
    gateway, log = fresh.loop.gateway, fresh.loop.event_log
    state = RestartState(tmp_path, BusSettings("socketcan", "vcan0"), gateway, log)
    assert state.path is not None
    kept: list[str | None] = []
    path = state.path
    state.begin()
    fresh.loop.keep(state)

    def look(event: Event) -> None:
        """On the ticking thread, between the grant and the answer."""
        if event.name == "api_request":
            kept.append(read(path).cut)

    log.subscribe(look)
    told(fresh, {"jsonrpc": "2.0", **form, "method": "estop"})
    assert kept == ["emergency stop requested: cut"]


def idle(gateway: Driven) -> socket.socket:
    one = socket.socket(socket.AF_UNIX)
    one.settimeout(30)
    one.connect(str(gateway.socket_path))
    return one


def test_sixteen_idle_connections_keep_nobody_from_stopping_ten_of_ten(fresh: Driven):
    crowd = [idle(fresh) for _ in range(16)]
    for _ in range(10):
        with fresh.client() as client:
            assert client.estop()["granted"]
        fresh.until_mode("fault")
        crowd += [idle(fresh)]
        fresh.until(lambda: fresh.latest_why.next_step == "service reset", "the hold's end")
        fresh.until(lambda: is_reset(fresh), "a reset")
        fresh.until_ready()
        crowd += [idle(fresh)]
    with fresh.client() as client:
        counts = client.health()["api"]
        closed = [one for one in client.events(200)["events"] if one["name"] == "api_client_closed"]
    assert counts["turned_away"] == 0
    assert counts["gave_way"] == counts["closed"]["gave way to a new connection"] >= 20
    assert closed[0]["fields"]["reason"] == "gave way to a new connection"
    assert sum(one["count"] for one in closed) < 20, "told once a second at most"
    for one in crowd:
        one.close()


@pytest.mark.clock
def test_a_crowd_does_not_end_the_drive_of_the_one_with_the_demand(driving: Driven):
    crowd = [idle(driving) for _ in range(60)]
    with driving.client() as client:
        assert client.health()["api"]["gave_way"] >= 40
        assert driving.mode == "active"
    for one in crowd:
        one.close()


def test_who_had_the_demand_gives_way_once_it_has_expired(fresh: Driven):
    crowd = [idle(fresh)]
    request = {"source": "driver", "sequence": 1, "ttl_ms": 100, "values": {}}
    message = {"jsonrpc": "2.0", "id": 1, "method": "demand.set", "params": request}
    crowd[0].sendall(json.dumps(message).encode() + b"\n")
    assert b"granted" in crowd[0].recv(65536)
    time.sleep(0.2)
    crowd += [idle(fresh) for _ in range(16)]
    assert crowd[0].recv(65536) == b""
    for one in crowd:
        one.close()


def test_what_fills_the_queue_of_the_ticking_thread_leaves_room_for_a_stop(fresh: Driven):
    begun, held, work_queue = threading.Event(), threading.Event(), fresh.loop.work_queue

    def hold() -> None:
        begun.set()
        held.wait(30)

    work_queue.post(hold)
    assert begun.wait(30)
    with fresh.client() as client:
        while work_queue.offer(lambda: None):
            pass
        with pytest.raises(ApiError, match="too many requests wait"):
            client.arm()
        threading.Timer(0.05, held.set).start()
        assert client.estop()["granted"]
    fresh.until_mode("fault")
