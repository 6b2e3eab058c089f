"""What became of our frames: sent, confirmed, and what they carried."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

# The echo is held against a second or so before a Status1 that may be 1.6 s old.
_HISTORY_FRAMES = 80


@dataclass(frozen=True, slots=True)
class SentValues:
    """Throttle and direction of one command frame that was sent."""

    at_ns: int
    throttle_pct: float
    reverse: bool = False


class SentHistory:
    """Book of the frames that left, one page a controller."""

    def __init__(self, controllers: tuple[str, ...]) -> None:
        self._history: dict[str, deque[SentValues]] = {
            name: deque(maxlen=_HISTORY_FRAMES) for name in controllers
        }
        self._confirmed_before = dict.fromkeys(controllers, 0)
        self._missed = dict.fromkeys(controllers, 0)
        self._emitted = False

    def note_sent(self, controller: str, sent: SentValues) -> None:
        """A frame was handed to the bus."""
        self._history[controller].append(sent)

    @property
    def unsent(self) -> list[str]:
        """The controllers for which no frame has left yet."""
        return [name for name, sent in self._history.items() if not sent]

    @property
    def begun(self) -> bool:
        """True once a frame has left for every controller."""
        return all(self._history.values())

    def note_emitted(self, emitted: bool) -> None:
        """Whether this tick gave frames to send at all."""
        self._emitted = emitted

    def note_confirmed(self, confirmed: Mapping[str, int]) -> int:
        """Take the echo counts at the start of a tick; ticks in a row without an echo."""
        for name, count in confirmed.items():
            if count != self._confirmed_before[name]:
                self._missed[name] = 0
            elif self._emitted:
                self._missed[name] += 1
            self._confirmed_before[name] = count
        return max(self._missed.values())

    @property
    def history(self) -> Mapping[str, Sequence[SentValues]]:
        """What the last frames sent said, oldest first, by controller; it goes on."""
        return self._history
