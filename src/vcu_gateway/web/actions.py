"""What the page may ask of the gateway: stop, disarm, arm, reset; never a demand.

The emergency stop is asked for again and again until the gateway has answered, and confirmed by
what the gateway then sends to the controllers.
"""

import asyncio
import time
from pathlib import Path
from typing import Literal, TypedDict

from vcu_gateway.api.results import Granted
from vcu_gateway.client import ApiError, AsyncClient, ClientError
from vcu_gateway.client.calls import Call, arm, disarm, estop, reset
from vcu_gateway.web.gateway_link import GatewayLink

_TRY_TIMEOUT_S = 0.3
_TRIES_FOR_S = 0.9
_AGAIN_S = 0.05
_CUT_WITHIN_S = 0.6
_ASK_TIMEOUT_S = 1.0


class Answer(TypedDict):
    """The answer to an action.

    Attributes:
        answered: the gateway has; granted: and has done it.
        confirmed: of the emergency stop: mode fault and POWER_CUT in both frames were seen.
        frames: the command frames that show it, as candump writes them.
    """

    answered: bool
    granted: bool
    confirmed: bool
    mode: str | None
    sentence: str
    frames: dict[str, str | None]


CALLS: dict[str, Call[Granted]] = {
    "disarm": disarm(),
    "arm": arm(),
    "reset driver": reset("driver"),
    "reset service": reset("service"),
}


class Actions:
    """Actions on the gateway, on connections of their own: a stop waits for nothing else."""

    def __init__(self, socket_path: Path, link: GatewayLink) -> None:
        self._link = link
        self._stopping = AsyncClient(socket_path, _TRY_TIMEOUT_S)
        self._asking = AsyncClient(socket_path, _ASK_TIMEOUT_S)

    async def act(self, name: str) -> Answer:
        """Carry out an action of `roles.ACTION_RIGHTS`."""
        if name == "estop":
            return await self._stop()
        client = self._stopping if name == "disarm" else self._asking
        try:
            granted = await client.call(CALLS[name])
        except ApiError as error:
            return _answer(answered=True, sentence=error.sentence)
        except ClientError as error:
            return _answer(answered=False, sentence=str(error))
        return _answer(answered=True, granted=True, mode=granted["mode"])

    async def _stop(self) -> Answer:
        asked_ns = time.monotonic_ns()
        answer = await self._ask_to_stop()
        confirmed = await self._link.until_cut(asked_ns, _CUT_WITHIN_S if answer["granted"] else 0)
        latest = self._link.latest
        if confirmed and latest is not None:
            answer["mode"] = latest["mode"]
            answer["frames"] = {name: one["frame"] for name, one in latest["commands"].items()}
        answer["confirmed"] = confirmed
        return answer

    async def _ask_to_stop(self) -> Answer:
        """Ask until it has answered, for 0.9 s; the browser asks again after that."""
        end_s = time.monotonic() + _TRIES_FOR_S
        while True:
            try:
                granted = await self._stopping.call(estop())
            except ApiError as error:
                # The gateway stops also where a request is wrong in form, and says so.
                return _answer(answered=True, granted=True, sentence=error.sentence)
            except ClientError as error:
                if time.monotonic() >= end_s:
                    return _answer(answered=False, sentence=str(error))
                await asyncio.sleep(_AGAIN_S)
            else:
                return _answer(answered=True, granted=True, mode=granted["mode"])

    async def close(self) -> None:
        """Close the connections."""
        await self._stopping.close()
        await self._asking.close()


def _answer(
    *,
    answered: bool,
    granted: bool = False,
    mode: Literal["starting", "standby", "active", "fault", "stopping"] | None = None,
    sentence: str = "",
) -> Answer:
    return {
        "answered": answered,
        "granted": granted,
        "confirmed": False,
        "mode": mode,
        "sentence": sentence,
        "frames": {},
    }
