"""Methods that only read: answered at once, on the API's thread."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from vcu_gateway import config as configuration
from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.server import health, views
from vcu_gateway.server.context import ServerContext


def state(program: ServerContext, messages: list[str] | None) -> results.State:
    """What is known now; Failure for a message that the gateway does not receive."""
    latest = program.latest()
    snapshot = program.daemon.gateway.intake.store.snapshot(time.monotonic_ns())
    known = [message.name for message in snapshot.messages]
    for name in messages or ():
        if name not in known:
            sentence = f"the gateway receives no message {name[:64]}; it knows {', '.join(known)}"
            raise RequestError(ErrorCode.INVALID_PARAMS, sentence)
    return views.state(snapshot, latest, messages)


def _state(program: ServerContext, params: methods.StateParams) -> results.State:
    return state(program, params.messages)


def _why(program: ServerContext, _: methods.Nothing) -> results.Why:
    return views.why(program.latest().why)


def _health(program: ServerContext, _: methods.Nothing) -> results.Health:
    config = program.in_effect.config
    return health.health(program.daemon, program.bus, config, program.facts, program.api_counts())


def _config(program: ServerContext, _: methods.Nothing) -> results.ConfigInEffect:
    config = program.in_effect.config
    return {
        "file": config.source.file,
        "digest": configuration.digest(config),
        "values": configuration.effective(config),
    }


def _protocol(program: ServerContext, _: methods.Nothing) -> results.Protocol:
    return program.protocol


QUERIES: Mapping[str, Callable[[ServerContext, Any], Any]] = {
    "state.get": _state,
    "why": _why,
    "health": _health,
    "config.get": _config,
    "protocol.get": _protocol,
}
