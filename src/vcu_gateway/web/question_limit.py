"""Limit on questions: what each costs, by address and by session; a stop is done at once."""

import asyncio
import time

from starlette.types import Scope

from vcu_gateway.units import NS_PER_S
from vcu_gateway.web.connections import SESSION, STOPS
from vcu_gateway.web.cost_limit import CostLimit

HISTORY = "/api/history"

_LONGEST_WAIT_NS = NS_PER_S
_COSTS = {HISTORY: 20}


class QuestionLimit:
    """Limits of an address and of a session.

    Who asks too much waits up to a second for an answer, and is then refused: a connection that
    asks without end has one answer a second. A stop and signing in are never held up, but the
    answers to them are, where one session, or one address without any, asks without end.
    """

    def __init__(self) -> None:
        self._addresses = CostLimit(burst=300, per_s=60)
        self._sessions = CostLimit(burst=200, per_s=40)
        self._stops = CostLimit(burst=20, per_s=10)

    async def has_turn(self, scope: Scope) -> bool:
        """Wait for the turn of this request; False where it is refused."""
        cost = cost_of(scope["method"], scope["path"])
        if not cost:
            return True
        wait_ns = self.wait_ns(_address(scope), _cookie(scope), cost, time.monotonic_ns())
        await _wait(wait_ns)
        return wait_ns <= _LONGEST_WAIT_NS

    async def hold_answer(self, scope: Scope) -> None:
        """Wait before the answer to a stop, where too many were asked for."""
        if not cost_of(scope["method"], scope["path"]):
            key, now_ns = _cookie(scope) or _address(scope), time.monotonic_ns()
            wait_ns = self._stops.wait_ns(key, 1, now_ns)
            if wait_ns <= _LONGEST_WAIT_NS:
                self._stops.take(key, 1, now_ns)
            await _wait(wait_ns)

    def wait_ns(self, address: str, cookie: str, cost: int, now_ns: int) -> int:
        """Time to wait; the cost is taken where it is no longer than a second."""
        keys = [(self._addresses, address)] + ([(self._sessions, cookie)] if cookie else [])
        wait_ns = max(limit.wait_ns(key, cost, now_ns) for limit, key in keys)
        if wait_ns <= _LONGEST_WAIT_NS:
            for limit, key in keys:
                limit.take(key, cost, now_ns)
        return wait_ns


async def _wait(wait_ns: int) -> None:
    """Wait so long, a second at most; not at all at 0: who has sent all is gone a moment later."""
    if wait_ns:
        await asyncio.sleep(min(wait_ns, _LONGEST_WAIT_NS) / NS_PER_S)


def cost_of(method: str, path: str) -> int:
    """Cost of a question; 0 for a stop and for signing in, which have limits of their own."""
    if method == "POST" and (path in STOPS or path == SESSION):
        return 0
    return _COSTS.get(path, 1)


def _address(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else ""


def _cookie(scope: Scope) -> str:
    values = [value for name, value in scope["headers"] if name == b"cookie"]
    return b";".join(values).decode("latin-1")
