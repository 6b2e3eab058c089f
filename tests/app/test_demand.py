"""The demand of a client: the dead-man's handle in each of its forms, and one owner at a time.

The same on a real vcan0, by kernel stamps: tests/vcan/test_api.py.
"""

import itertools
import json
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.driven import Driven, driven
from vcu_gateway.client import RefusedError

README = Path(__file__).parents[2] / "README.md"
NAMES = (f"driver{number}" for number in itertools.count())


class Raw:
    """A client that does exactly what a test says, by default in a name of its own."""

    def __init__(self, gateway: Driven, source: str | None = None) -> None:
        self.source = source or next(NAMES)
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(30)
        self.socket.connect(str(gateway.socket_path))
        self._reader = self.socket.makefile("r")
        self._id = 0

    def ask(self, method: str, **params: Any) -> dict[str, object]:
        self._id += 1
        request = {"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}
        self.socket.sendall(json.dumps(request).encode() + b"\n")
        answer = json.loads(self._reader.readline())
        assert answer["id"] == self._id
        return answer

    def demand(self, sequence: int, throttle_pct: float = 0.0, **params: Any):
        values = {"throttle_pct": throttle_pct, "power_mode": "normal"}
        params = {"source": self.source, "sequence": sequence, "values": values} | params
        return self.ask("demand.set", **params)

    def arm(self):
        """Ask once the throttle has been released for long enough."""
        time.sleep(0.21)
        return self.ask("arm")

    def close(self) -> None:
        self._reader.close()
        self.socket.close()


@pytest.fixture
def raw(running) -> Iterator[Raw]:
    one = Raw(running)
    yield one
    one.close()
    running.until(lambda: running.mode == "standby", "standby after the test")
    running.until(lambda: not running.latest_why.demand_fresh, "the demand's end")


def refusal_of(answer: dict) -> str:
    return answer["error"]["data"]["refusal"]


@pytest.mark.clock
def test_a_demand_drives_after_arming_and_its_release_ends_the_drive(running):
    with running.client() as client, client.demand("driver") as owner:
        assert client.arm()["mode"] == "active"
        running.throttles()
        owner.set(throttle_pct=20, power_mode="normal")
        running.until(lambda: max(running.throttles(), default=0) > 0, "throttle on the bus")
    running.until_mode("standby")
    running.throttles()
    running.until(lambda: running.throttles() == {0}, "zero torque")


@pytest.mark.clock
def test_a_demand_that_is_not_renewed_ends_with_its_time_to_live(running, raw):
    assert "result" in raw.demand(1, ttl_ms=1000)
    assert raw.arm()["result"]["mode"] == "active"
    raw.demand(2, 30, ttl_ms=300)
    running.until_mode("standby")
    assert raw.ask("arm")["error"]["message"] == "there is no fresh demand"


@pytest.mark.clock
def test_the_end_of_the_connection_ends_the_demand_before_its_time_to_live(running):
    one = Raw(running)
    one.demand(1, ttl_ms=1000)
    one.arm()
    one.demand(2, 30, ttl_ms=1000)
    begun = time.monotonic()
    one.close()
    running.until_mode("standby")
    assert time.monotonic() - begun < 0.9


@pytest.mark.clock
def test_a_half_closed_connection_ends_the_demand(running):
    one = Raw(running)
    one.demand(1, ttl_ms=1000)
    one.arm()
    one.demand(2, 30, ttl_ms=1000)
    begun = time.monotonic()
    one.socket.shutdown(socket.SHUT_WR)
    running.until_mode("standby")
    assert time.monotonic() - begun < 0.9
    one.close()


def test_an_old_sequence_number_is_refused_and_does_not_renew(running, raw):
    raw.demand(7, ttl_ms=200)
    assert refusal_of(raw.demand(7, 50)) == "old_sequence"
    assert refusal_of(raw.demand(6, 50)) == "old_sequence"
    running.until(lambda: not running.latest_why.demand_fresh, "the demand's end")


def test_a_demand_that_waited_too_long_on_its_way_is_refused(raw):
    made_ns = time.monotonic_ns() - 201_000_000
    answer = raw.demand(1, made_ns=made_ns)
    assert refusal_of(answer) == "expired"
    age_ms, ttl_ms = map(int, re.findall(r"(\d+) ms", answer["error"]["message"]))
    assert age_ms > ttl_ms == 200, "no age that its own sentence allows"
    assert "valid for 200 ms (ttl_ms)" in answer["error"]["message"]
    assert refusal_of(raw.demand(2, made_ns=time.monotonic_ns() + 60 * 10**9)) == "from_the_future"


@pytest.mark.clock
def test_a_second_source_is_refused_while_the_first_is_fresh(running, raw):
    raw.demand(1, ttl_ms=1000)
    with running.client() as other, pytest.raises(RefusedError) as caught, other.demand("remote"):
        pass
    assert caught.value.refusal == "other_owner"
    assert caught.value.sentence == f"{raw.source} owns the demand"


@pytest.mark.clock
def test_a_second_connection_in_the_same_name_is_refused(running, raw):
    raw.demand(1, ttl_ms=1000)
    second = Raw(running, raw.source)
    assert refusal_of(second.demand(2, 50)) == "other_owner"
    assert refusal_of(second.ask("demand.release", source=raw.source)) == "other_owner"
    second.close()
    running.until(
        lambda: running.latest_why.demand_source == raw.source and running.latest_why.demand_fresh,
        "a tick that sees the first one's demand",
    )


@pytest.mark.clock
def test_a_higher_priority_takes_over(tmp_path):
    with driven(tmp_path, "demand: {priorities: {remote_stop: 10}}\n") as gateway:
        gateway.until_ready()
        driver = Raw(gateway)
        driver.demand(1, ttl_ms=1000)
        stopper = Raw(gateway)
        assert "result" in stopper.demand(1, source="remote_stop", ttl_ms=1000)
        assert refusal_of(driver.demand(2, 50)) == "other_owner"
        driver.close()
        stopper.close()


@pytest.mark.parametrize(
    ("params", "refusal"),
    [
        ({"values": {"throttle_pct": 100.1}}, "out_of_range"),
        ({"values": {"brake_pct": -1}}, "out_of_range"),
        ({"values": {"speed_limit_rpm": 12001}}, "out_of_range"),
        ({"ttl_ms": 0}, "ttl_out_of_range"),
        ({"ttl_ms": 1001}, "ttl_out_of_range"),
        ({"source": "bench"}, "name_reserved"),
        ({"values": None, "controllers": {"PCU1": {}}}, "controller_missing"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_word(raw, params, refusal):
    answer = raw.demand(1, **params)
    assert refusal_of(answer) == refusal
    assert answer["error"]["message"]


@pytest.mark.parametrize(
    "params",
    [
        {"values": None},
        {"controllers": {"PCU1": {}, "PCU2": {}}},
        {"values": {"throttle": 5}},
        {"values": {"throttle_pct": "5"}},
        {"values": {"throttle_pct": True}},
        {"sequence": 2**63},
        {"source": "a b"},
    ],
)
def test_parameters_of_a_wrong_form_are_refused(raw, params):
    assert raw.demand(**{"sequence": 1} | params)["error"]["code"] == -32602


@pytest.mark.clock
def test_each_controller_may_be_asked_for_its_own(running):
    with running.client() as client, client.demand("driver") as owner:
        client.arm()
        controllers = {"PCU1": {"throttle_pct": 10.0}, "PCU2": {"throttle_pct": 5.0}}
        owner.set(**controllers)
        running.until(
            lambda: (
                [round(one["throttle_pct"]) for one in client.state(())["commands"].values()]
                == [10, 5]
            ),
            "each throttle",
        )
    running.until_mode("standby")


def test_an_emergency_stop_cuts_and_needs_a_service_reset(fresh):
    with fresh.client() as client:
        client.estop()
        fresh.until(lambda: client.why()["mode"] == "fault", "the fault in the answers")
        assert client.why()["latch"]["fault_class"] == "service"
        assert client.state(())["commands"]["PCU1"]["power_cut"] is True
        with pytest.raises(RefusedError, match="service level"):
            client.reset()
        fresh.until(lambda: fresh.latest_why.next_step == "service reset", "the hold's end")
        assert client.reset("service")["mode"] == "starting"
    fresh.until_mode("standby")


@pytest.mark.clock
def test_the_program_in_the_readme_drives(running, monkeypatch, capsys):
    (program,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    running.until_ready()
    monkeypatch.setenv("VCU_GATEWAY_SOCKET", str(running.socket_path))
    exec(compile(program, str(README), "exec"), {})
    said = capsys.readouterr().out.splitlines()  # the gateway's log comes in between
    assert any(line.startswith("active; demand of driver ") for line in said)
    running.until_mode("standby")
