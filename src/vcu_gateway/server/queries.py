"""Handlers of the methods that only read: answered at once, on the API's thread."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from vcu_gateway import config as configuration
from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.server import health, views
from vcu_gateway.server.context import ServerContext


def state(context: ServerContext, messages: list[str] | None) -> results.State:
    """Current state; RequestError for a message that the gateway does not receive."""
    latest = context.latest()
    gateway, now_ns = context.loop.gateway, time.monotonic_ns()
    known = [message.name for message in gateway.snapshot(now_ns).messages] if messages else []
    for name in messages or ():
        if name not in known:
            sentence = f"the gateway receives no message {name[:64]}; it knows {', '.join(known)}"
            raise RequestError(ErrorCode.INVALID_PARAMS, sentence)
    return views.state(gateway, latest, now_ns, messages)


def _health(context: ServerContext, _: methods.Nothing) -> results.Health:
    config = context.in_effect.config
    api, now_ns = context.api_counts(), time.monotonic_ns()
    return health.health(context.loop, context.bus, config, context.facts, api, now_ns)


def _config(context: ServerContext, _: methods.Nothing) -> results.ConfigInEffect:
    config = context.in_effect.config
    return {
        "file": config.source.file,
        "digest": configuration.digest(config),
        "values": configuration.effective(config),
    }


QUERIES: Mapping[str, Callable[[ServerContext, Any], Any]] = {
    "state.get": lambda context, params: state(context, params.messages),
    "why": lambda context, _: views.why(context.latest().why),
    "health": _health,
    "config.get": _config,
    "protocol.get": lambda context, _: context.protocol,
}
"""Handlers by method."""
