"""What must have happened before the gateway talks, and before it may leave STARTING."""

from collections.abc import Iterator

from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.why import WAITING_FOR
from vcu_gateway.units import NS_PER_MS


class ListenBeforeTalk:
    """Listen before talk: silent for a while, and as long as another sender is heard.

    Once over it is over until the next start.
    """

    def __init__(self, now_ns: int, listen_ms: int) -> None:
        self._quiet_until_ns = now_ns + listen_ms * NS_PER_MS
        self._listen_ns = listen_ms * NS_PER_MS
        self.over = False

    def again(self, now_ns: int) -> None:
        """Another sender was heard, or the bus was not there: begin the whole time again."""
        self._quiet_until_ns = now_ns + self._listen_ns

    def update(self, now_ns: int) -> bool:
        """True from the end of the listening on."""
        self.over = self.over or now_ns >= self._quiet_until_ns
        return self.over


class Qualification:
    """Enough good frames of every required message since one of them, or the link, was lost."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}
        self._missing: set[str] | None = None

    def observe(self, snapshot: Snapshot, required: tuple[str, ...]) -> bool:
        """Begin anew where a required message was lost; True while none is missing."""
        missing = {message for message in required if snapshot.stale(message)}
        if self._missing is not None and missing - self._missing:
            self.begin(snapshot, required)
        self._missing = missing
        return not missing

    def begin(self, snapshot: Snapshot, required: tuple[str, ...]) -> None:
        """Count from now on."""
        self._before = {message: _good_frames(snapshot, message) for message in required}

    def missing(self, snapshot: Snapshot, settings: Settings) -> Iterator[str]:
        """What is still waited for, as sentences; nothing where all is there."""
        for message in settings.required:
            good = _good_frames(snapshot, message) - self._before.get(message, 0)
            if snapshot.stale(message):
                yield f"{WAITING_FOR}{message}"
            elif good < settings.qualify_frames:
                yield f"{WAITING_FOR}{message}: {good} of {settings.qualify_frames} good frames"


def _good_frames(snapshot: Snapshot, message: str) -> int:
    latest = snapshot.latest(message)
    return 0 if latest is None else latest.frame_count - latest.marked_count
