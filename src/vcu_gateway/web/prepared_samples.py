"""Answers with samples, encoded once for all who ask for the same, beside the loop."""

import asyncio
import json
import time
from collections.abc import Callable

from vcu_gateway.web.history import Samples
from vcu_gateway.web.page_files import EncodedBody

_KEPT_S = 1.0
_KEPT = 16

Question = tuple[tuple[str, ...], int]
"""Names of the signals, and the number of points."""


class PreparedSamples:
    """Encoded samples, each a second old at most; one answer is put together at a time.

    That is done on another thread: a stop does not wait for it.
    """

    def __init__(
        self,
        read: Callable[[tuple[str, ...], int], Samples],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._read = read
        self._now_s = now_s
        self._kept: dict[Question, tuple[float, EncodedBody]] = {}
        self._one_at_a_time = asyncio.Lock()

    async def encoded(self, names: tuple[str, ...], points: int) -> EncodedBody:
        question = (names, points)
        async with self._one_at_a_time:
            kept = self._kept.get(question)
            if kept is not None and self._now_s() - kept[0] < _KEPT_S:
                return kept[1]
            encoded = await asyncio.to_thread(self._encode, names, points)
            self._keep(question, encoded)
            return encoded

    def _encode(self, names: tuple[str, ...], points: int) -> EncodedBody:
        plain = json.dumps(self._read(names, points), separators=(",", ":")).encode()
        return EncodedBody.of("application/json", plain)

    def _keep(self, question: Question, encoded: EncodedBody) -> None:
        self._kept.pop(question, None)
        self._kept[question] = (self._now_s(), encoded)
        if len(self._kept) > _KEPT:
            del self._kept[next(iter(self._kept))]
