"""Client of a running gateway.

    from vcu_gateway.client import Client, RefusedError

    with Client() as client:
        print(client.why()["sentence"])

        with client.demand("driver") as owner:  # demands no motion, so that arming is possible
            client.arm()
            while driving():
                owner.set(throttle_pct=20)  # at least twice a second: a dead-man's handle
        # left, also by an exception: no motion, the demand released

        with client.subscribe(["BMS_Status"], rate_hz=10) as updates:
            for update in updates:
                print(update["state"]["mode"], update["lost"])

`AsyncClient` is the same for asyncio: `await client.why()`, `async with client.demand("driver")`,
`async for update in client.subscribe()`. Results are the dictionaries of `vcu_gateway.api.results`.
Every failure is a `ClientError`; its subclasses tell them apart. docs/examples has whole programs.
"""

from typing import TYPE_CHECKING, Any

from vcu_gateway.client.demand import ControllerValues, DemandValues
from vcu_gateway.client.errors import (
    ApiError,
    ApiTimeoutError,
    ClientError,
    ConfigRefusedError,
    DisconnectedError,
    GarbledError,
    NoRightError,
    RefusedError,
    UnreachableError,
)
from vcu_gateway.client.jsonrpc import default_socket_path
from vcu_gateway.client.sync_client import Client, Subscription
from vcu_gateway.client.sync_demand import DemandOwner

if TYPE_CHECKING:
    from vcu_gateway.client.async_client import AsyncClient, AsyncSubscription
    from vcu_gateway.client.async_demand import AsyncDemandOwner

__all__ = [
    "ApiError",
    "ApiTimeoutError",
    "AsyncClient",
    "AsyncDemandOwner",
    "AsyncSubscription",
    "Client",
    "ClientError",
    "ConfigRefusedError",
    "ControllerValues",
    "DemandOwner",
    "DemandValues",
    "DisconnectedError",
    "GarbledError",
    "NoRightError",
    "RefusedError",
    "Subscription",
    "UnreachableError",
    "default_socket_path",
]

_ASYNCIO_MODULES = {
    "AsyncClient": "async_client",
    "AsyncDemandOwner": "async_demand",
    "AsyncSubscription": "async_client",
}


def __getattr__(name: str) -> Any:
    """Import asyncio for those who use it: it takes longer than all of the rest."""
    if name not in _ASYNCIO_MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_ASYNCIO_MODULES[name]}"), name)
