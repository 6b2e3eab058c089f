"""Lifecycle: listen before talk, qualification for STANDBY, orderly shutdown."""

from collections.abc import Iterable, Iterator, Mapping

from vcu_gateway.core.settings import Settings
from vcu_gateway.core.snapshot import Snapshot
from vcu_gateway.core.why import WAITING_FOR
from vcu_gateway.units import NS_PER_MS


class ListenBeforeTalk:
    """Listen before talk: silent for a while, and as long as another sender is there.

    Once over it is over until the next start.
    """

    def __init__(self, now_ns: int, listen_ms: int) -> None:
        self._quiet_until_ns = now_ns + listen_ms * NS_PER_MS
        self._listen_ns = listen_ms * NS_PER_MS
        self.over = False

    def again(self, now_ns: int) -> None:
        """Begin the whole time again: there was another sender, or no bus."""
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
        missing = set(snapshot.stale_messages()).intersection(required)
        if self._missing is not None and missing - self._missing:
            self.begin(snapshot, required)
        self._missing = missing
        return not missing

    def begin(self, snapshot: Snapshot, required: tuple[str, ...]) -> None:
        self._before = {message: _good_frames(snapshot, message) for message in required}

    def missing(self, snapshot: Snapshot, settings: Settings) -> Iterator[str]:
        """Conditions still waited for, as sentences."""
        for message in settings.required_messages:
            good = _good_frames(snapshot, message) - self._before.get(message, 0)
            if snapshot.stale(message):
                yield f"{WAITING_FOR}{message}"
            elif good < settings.qualify_frames:
                yield f"{WAITING_FOR}{message}: {good} of {settings.qualify_frames} good frames"


def _good_frames(snapshot: Snapshot, message: str) -> int:
    latest = snapshot.latest(message)
    return 0 if latest is None else latest.frame_count - latest.marked_count


def echoed_directions(snapshot: Snapshot, controllers: Iterable[str]) -> Mapping[str, bool]:
    """Reverse or not, of each of these controllers that echoes its last command."""
    readings = {name: snapshot.reading(f"{name}_Status1", "MotorReverse") for name in controllers}
    return {
        name: bool(one.good_value) for name, one in readings.items() if one.good_value is not None
    }


_TICKS = 3
_TICKS_AT_MOST = 10


class Shutdown:
    """Orderly end: a few ticks of safe frames in STOPPING."""

    def __init__(self) -> None:
        self._ticks = 0
        self._unsent_ticks = 0
        self._unsent_in_tick = False

    def note_tick(self, stopping: bool) -> None:
        self._unsent_ticks += self._unsent_in_tick and self._ticks > 0
        self._unsent_in_tick = False
        self._ticks += stopping

    def note_unsent(self) -> None:
        self._unsent_in_tick = True

    def over(self, talking: bool) -> bool:
        """True where the safe frames were sent, or cannot be; valid after each tick's sending."""
        return self._ticks > 0 and (self._sent or self.gave_up or not talking)

    @property
    def gave_up(self) -> bool:
        """True where the bus did not take the safe frames in time; valid as `over` is."""
        return self._ticks >= _TICKS_AT_MOST and not self._sent

    @property
    def _sent(self) -> bool:
        return self._ticks - self._unsent_ticks - self._unsent_in_tick >= _TICKS
