"""The client knows the contract: every method, its parameters, what it changes."""

import asyncio
import inspect
from typing import Any

import pytest

from vcu_gateway.api.errors import Right
from vcu_gateway.api.methods import METHODS
from vcu_gateway.client import AsyncClient, AsyncDemandOwner, Client, DemandOwner
from vcu_gateway.client.calls import Call, subscribing
from vcu_gateway.client.errors import DisconnectedError, GarbledError


class Noted(Client):
    def call(self, call: Call[Any]) -> Any:
        return call


class AsyncNoted(AsyncClient):
    async def call(self, call: Call[Any]) -> Any:
        return call


def calls_of(client: Any) -> list[Any]:
    return [
        client.state(),
        client.state(["BMS_Status"]),
        client.why(),
        client.health(),
        client.events(200),
        client.config(),
        client.protocol(),
        client.arm(),
        client.disarm(),
        client.reset(),
        client.reset("service"),
        client.set_drive_mode("eco"),
        client.set_drive_mode("eco", "service"),
        client.tuning(),
        client.estop(),
        client.reload(),
    ]


async def awaited() -> list[Call[Any]]:
    return [await one for one in calls_of(AsyncNoted())]


CALLS: list[Call[Any]] = [
    *calls_of(Noted()),
    subscribing(None, 10.0),
    subscribing(("BMS_Status",), 50),
]
NOT_CALLS = {"demand.set", "demand.release", "state.unsubscribe"}
CHANGING = {"arm", "disarm", "reset", "drive_mode.set", "estop", "config.reload"}


def test_every_method_of_the_contract_can_be_called():
    assert {call.method for call in CALLS} | NOT_CALLS == set(METHODS)


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.method)
def test_the_parameters_are_those_of_the_contract(call):
    METHODS[call.method].params.model_validate(call.params)


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.method)
def test_what_needs_a_right_or_stops_the_vehicle_counts_as_a_change(call):
    assert call.changes == (call.method in CHANGING)
    assert call.changes or METHODS[call.method].right is Right.READ


def test_both_clients_send_the_same():
    assert asyncio.run(awaited()) == calls_of(Noted())


def test_what_only_tells_may_retry_after_any_break():
    assert Call[Any]("why").may_retry(DisconnectedError("broken"))
    assert Call[Any]("why").may_retry(GarbledError("rubbish"))


def test_what_changes_may_retry_only_where_it_cannot_have_arrived():
    assert not Call[Any]("arm").may_retry(DisconnectedError("broken"))
    assert not Call[Any]("arm").may_retry(GarbledError("rubbish"))
    assert Call[Any]("arm").may_retry(DisconnectedError("broken", carried_out=False))


@pytest.mark.parametrize(("one", "other"), [(Client, AsyncClient), (DemandOwner, AsyncDemandOwner)])
def test_both_clients_have_the_same_methods_with_the_same_parameters(one, other):
    def signatures(kind):
        functions = inspect.getmembers(kind, inspect.isfunction)
        return {
            name: str(inspect.signature(function).replace(return_annotation="any"))
            for name, function in functions
            if not name.startswith("_") or name == "__init__"
        }

    assert signatures(one) == signatures(other)


@pytest.mark.parametrize(
    ("function", "name", "default"),
    [
        (Client, "timeout_s", 2.0),
        (Client.subscribe, "rate_hz", 10.0),
        (Client.events, "limit", 50),
        (Client.reset, "level", "driver"),
        (Client.demand, "ttl_ms", 200),
        (Client.demand, "hold_s", 0.5),
    ],
)
def test_what_is_left_out_has_its_documented_default(function, name, default):
    assert inspect.signature(function).parameters[name].default == default
