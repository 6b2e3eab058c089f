"""Request that any number of connections make at once, and that is carried out once for all."""

from collections import deque
from collections.abc import Callable

from vcu_gateway.server.service import Caller, Reply


class SharedRequest:
    """Request without parameters, merged over those who wait: a flood of it is one at a time.

    Each is carried out after it was asked for, and named in the log as the first one's. `ask` is
    the API thread's, `execute` runs on the ticking thread, where `post` brings it.
    """

    def __init__(
        self, execute: Callable[[Caller], Reply], post: Callable[[Callable[[], None]], None]
    ) -> None:
        self._execute = execute
        self._post = post
        self._asked: deque[tuple[Caller, Callable[[Reply], None]]] = deque()
        self._is_posted = False

    def ask(self, caller: Caller, reply: Callable[[Reply], None]) -> None:
        """Ask; `reply` is called later, from the ticking thread."""
        self._asked.append((caller, reply))
        if not self._is_posted:
            self._is_posted = True
            self._post(self._run)

    def _run(self) -> None:
        self._is_posted = False  # before the next line: what is asked from now on posts again
        asked = [self._asked.popleft() for _ in range(len(self._asked))]
        if asked:
            outcome = self._execute(asked[0][0])
            for _, reply in asked:
                reply(outcome)
