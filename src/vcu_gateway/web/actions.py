"""What the page may ask of the gateway: stop, disarm, arm, reset; never a demand.

The emergency stop is asked for again and again until the gateway has answered. What became of it
on the bus and at the controllers is no part of the answer: every state tells it.
"""

import asyncio
import functools
import time
from pathlib import Path
from typing import Any, TypedDict

from vcu_gateway.api.results import Granted, ModeName
from vcu_gateway.client import ApiError, AsyncClient, ClientError
from vcu_gateway.client.calls import Call, arm, disarm, estop, reset
from vcu_gateway.web.merged_call import MergedCall

_TRY_TIMEOUT_S = 0.3
_TRIES_FOR_S = 0.9
_AGAIN_S = 0.05
_ASK_TIMEOUT_S = 1.0


class Answer(TypedDict):
    """The answer to an action.

    Attributes:
        answered: the gateway has; granted: and will do it.
        mode: when it was granted; None where it was not, or where that is not known.
    """

    answered: bool
    granted: bool
    mode: ModeName | None
    sentence: str


CALLS: dict[str, Call[Granted]] = {
    "disarm": disarm(),
    "arm": arm(),
    "reset driver": reset("driver"),
    "reset service": reset("service"),
}


class Actions:
    """Actions on the gateway, on connections of their own: a stop waits for nothing else."""

    def __init__(self, socket_path: Path) -> None:
        self._stopping = AsyncClient(socket_path, _TRY_TIMEOUT_S)
        self._asking = AsyncClient(socket_path, _ASK_TIMEOUT_S)
        self._merged_stop = MergedCall(self._ask_to_stop)
        self._merged_disarm = MergedCall(functools.partial(self._ask, "disarm"))

    async def act(self, name: str) -> Answer:
        """Carry out an action of `roles.ACTION_RIGHTS`."""
        if name == "estop":
            return await self._merged_stop()
        return await (self._merged_disarm() if name == "disarm" else self._ask(name))

    async def _ask(self, name: str) -> Answer:
        client = self._stopping if name == "disarm" else self._asking
        try:
            return _granted(await client.call(CALLS[name]))
        except ApiError as error:
            return _answer(answered=True, sentence=error.sentence)
        except ClientError as error:
            return _answer(answered=False, sentence=str(error))

    async def _ask_to_stop(self) -> Answer:
        """Ask until it has answered, for 0.9 s; the browser asks again after that."""
        end_s = time.monotonic() + _TRIES_FOR_S
        while True:
            try:
                return _granted(await self._stopping.call(estop()))
            except ApiError as error:
                # The gateway stops also where a request is wrong in form, and says so.
                return _answer(answered=True, granted=True, sentence=error.sentence)
            except ClientError as error:
                if time.monotonic() >= end_s:
                    return _answer(answered=False, sentence=str(error))
                await asyncio.sleep(_AGAIN_S)

    async def close(self) -> None:
        await self._stopping.close()
        await self._asking.close()


def _granted(granted: Any) -> Answer:
    """The answer for one that a gateway of any version granted."""
    mode = granted.get("mode") if isinstance(granted, dict) else None
    return _answer(answered=True, granted=True, mode=mode)


def _answer(
    *, answered: bool, granted: bool = False, mode: ModeName | None = None, sentence: str = ""
) -> Answer:
    return {"answered": answered, "granted": granted, "mode": mode, "sentence": sentence}
