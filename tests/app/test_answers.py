"""Every method against a running gateway: its answer has the documented shape."""

import json
import time

import pytest

from vcu_gateway.api import openrpc
from vcu_gateway.api.methods import METHODS
from vcu_gateway.client import Client, RefusedError
from vcu_gateway.client.calls import Call
from vcu_gateway.server import queries
from vcu_gateway.server.dispatch import COMMANDS, RELOAD

SUBSCRIPTIONS = {"state.subscribe", "state.unsubscribe"}
BY_NAME = {
    "state.get": lambda client: client.state(),
    "why": lambda client: client.why(),
    "health": lambda client: client.health(),
    "events": lambda client: client.events(200),
    "config.get": lambda client: client.config(),
    "protocol.get": lambda client: client.protocol(),
    "config.reload": lambda client: client.reload(),
    "disarm": lambda client: client.disarm(),
}
ANSWERED_IN_STANDBY = [*queries.QUERIES, "events", RELOAD, "disarm"]


@pytest.fixture
def client(running):
    with running.client() as client:
        yield client


def test_every_method_has_exactly_one_answer():
    answered = [*queries.QUERIES, *COMMANDS, RELOAD, *SUBSCRIPTIONS]
    assert sorted(answered) == sorted(METHODS)


@pytest.mark.parametrize("method", BY_NAME)
def test_the_clients_method_returns_the_documented_shape(client: Client, method: str):
    result = BY_NAME[method](client)
    openrpc.result_adapter(METHODS[method].result).validate_python(result)


@pytest.mark.parametrize("method", ANSWERED_IN_STANDBY)
def test_the_result_has_the_documented_shape(client: Client, method: str):
    result = client.call(Call(method, {}))
    openrpc.result_adapter(METHODS[method].result).validate_python(result)
    json.dumps(result, allow_nan=False)


def test_the_state_tells_values_with_unit_quality_and_age(client, running):
    running.until(lambda: not client.state()["messages"]["PCU1_Status1"]["stale"], "PCU1_Status1")
    state = client.state(["BMS_Status"])
    assert list(state["messages"]) == ["BMS_Status"]
    message = state["messages"]["BMS_Status"]
    assert message["signals"]["SOC"]["unit"] == "%"
    assert message["signals"]["SOC"]["quality"] == "good"
    assert 0 <= message["age_ms"] < 1100
    assert state["mode"] == "standby"
    assert state["commands"]["PCU1"]["throttle_pct"] == 0
    assert state["stop"] is None


def test_a_command_is_told_as_it_was_decided_sent_and_came_back(client):
    for name, identifier in (("PCU1", "0008A7D0"), ("PCU2", "0008A8D0")):
        command = client.state([])["commands"][name]
        assert command["decided"] == f"{identifier}#0C000000E02E0000"
        for carried in (command["sent"], command["echoed"]):
            assert carried["frame"] == command["decided"]
            assert 0 <= carried["age_ms"] < 60_000


def test_a_message_that_there_is_not_is_named(client):
    with pytest.raises(Exception, match="receives no message BMS_Statsu"):
        client.state(["BMS_Statsu"])


def test_why_says_what_to_do(client):
    why = client.why()
    assert why["mode"] == "standby"
    assert why["demand"] is None
    assert why["next_step"] == "before arming: there is no fresh demand"
    assert why["next_step"] in why["sentence"]


def test_health_accounts_for_every_tick_and_tells_its_lateness(client):
    ticks = client.health()["ticks"]
    assert ticks["done"] >= ticks["lateness_ticks"] > 0
    assert 0 <= ticks["lateness_p50_us"] <= ticks["lateness_p99_us"] <= ticks["lateness_max_us"]
    assert ticks["period_ms"] == 50


def test_health_bins_every_tick_by_its_lateness(client):
    ticks = client.health()["ticks"]
    bounds_us = [bin_["up_to_us"] for bin_ in ticks["lateness_histogram"]]
    assert bounds_us == [50, 100, 200, 500, 1000, 2000, 5000, 10_000, 25_000, None]
    counted = sum(bin_["ticks"] for bin_ in ticks["lateness_histogram"])
    assert counted - ticks["done"] in (0, 1)  # a tick may come between the two


def test_health_tells_the_start_of_the_process_and_what_it_uses(client):
    health = client.health()
    assert health["start_time_s"] == pytest.approx(time.time() - health["uptime_ms"] / 1000, abs=1)
    used = health["process"]
    assert 10_000_000 < used["resident_memory_bytes"] < used["virtual_memory_bytes"]
    assert 0 < used["cpu_time_s"] <= time.process_time()
    assert 3 < used["open_fds"] < used["max_fds"]


def test_the_state_tells_what_a_fresh_demand_asks_and_nothing_without_one(client, running):
    assert client.state()["demanded"] == {}
    with running.client().demand("pedal") as demand:
        demand.set(brake_pct=12)
        asked = {"throttle_pct": 0, "brake_pct": 12}
        running.until(
            lambda: client.state()["demanded"] == {"PCU1": asked, "PCU2": asked}, "the demand"
        )
    running.until(lambda: client.state()["demanded"] == {}, "the demand to end")


def test_health_tells_the_starts_since_the_boot_and_the_unexpected_ones(client):
    health = client.health()
    assert (health["starts"], health["unexpected_restarts"]) == (3, 1)


def test_the_configuration_in_effect_is_told(client, running):
    config = client.config()
    assert config["file"] == str(running.file)
    assert config["values"]["limits"]["power_limit_max_w"] == 60_000
    assert config["digest"] == client.health()["config_digest"]


def test_the_protocol_is_told_with_ranges_and_code_names(client):
    messages = {message["name"]: message for message in client.protocol()["messages"]}
    assert messages["BMS_Status"]["can_id"] == "0x1808D0F4"
    signals = {signal["name"]: signal for signal in messages["BMS_Status"]["signals"]}
    assert signals["SOC"]["maximum"] == 100
    assert len(signals["CellUndervoltage"]["names"]) == 4


def test_a_refusal_has_a_word_for_programs_and_a_sentence_for_people(client):
    with pytest.raises(RefusedError) as caught:
        client.arm()
    assert caught.value.refusal == "not_allowed_now"
    assert caught.value.sentence == "there is no fresh demand"


def test_who_asked_for_what_is_in_the_events(client):
    client.disarm()
    events = [event for event in client.events()["events"] if event["name"] == "api_request"]
    assert events[-1]["fields"]["request"] == "disarm"
    assert {"uid", "pid"} <= events[-1]["fields"].keys()
