"""Snapshot of the state store: every message and signal as it is known at one instant."""

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from operator import itemgetter
from typing import NamedTuple

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.units import NS_PER_MS

# Stamps come from another clock reading than the tick's; more than this ahead is no stamp.
FUTURE_TOLERANCE_NS = 20 * NS_PER_MS


class Quality(Enum):
    """Quality of a value."""

    GOOD = "good"
    OUT_OF_RANGE = "out of range"
    SATURATED = "saturated"
    STALE = "stale"
    NEVER = "never"


class LatestFrame(NamedTuple):
    """The latest frame of one message.

    Attributes:
        arrival_ns: the kernel's stamp in monotonic time.
        frame_count: frames of this message so far.
        marked_count: frames with a signal out of range or saturated.
        period_ns: observed period, smoothed over about 8 frames; None before the second.
        life_repeats: frames in a row whose life signal was that of the frame before.
    """

    decoded: Decoded
    arrival_ns: int
    frame_count: int
    marked_count: int
    period_ns: int | None
    life_repeats: int = 0


class Reading(NamedTuple):
    """One signal at one instant; value, raw and age_ns are None where it never came."""

    name: str
    value: float | None
    raw: int | None
    unit: str
    quality: Quality
    age_ns: int | None
    code_name: str | None = None

    @property
    def good_value(self) -> float | None:
        """The value where it can be relied upon, else None."""
        return self.value if self.quality is Quality.GOOD else None


# Takes some signals' codes out of all codes of a message, by message and signals: an itemgetter
# made once takes a fifth of the time of looking for each signal in every tick.
Pickers = dict[tuple[str, tuple[str, ...]], Callable[[tuple[int, ...]], tuple[int, ...]]]


class Snapshot:
    """State of every message at one instant."""

    __slots__ = (
        *("_arrived", "_fresh", "_indexes", "_latest", "_pickers", "_specs"),
        "now_ns",
    )

    def __init__(
        self,
        now_ns: int,
        specs: Mapping[str, MessageSpec],
        indexes: Mapping[str, Mapping[str, int]],
        pickers: Pickers,
        latest: Mapping[str, LatestFrame],
        arrived: Mapping[str, Sequence[LatestFrame]],
        stale_after_ns: Mapping[str, int],
    ) -> None:
        self.now_ns = now_ns
        self._specs = specs
        self._indexes = indexes
        self._pickers = pickers
        self._latest = latest
        self._arrived = arrived
        fresh: set[str] = set()
        for name, frame in latest.items():  # in every tick: a comprehension is a call more
            if -FUTURE_TOLERANCE_NS <= now_ns - frame.arrival_ns <= stale_after_ns[name]:
                fresh.add(name)
        self._fresh = fresh

    @property
    def messages(self) -> tuple[MessageSpec, ...]:
        return tuple(self._specs.values())

    def latest(self, message: str) -> LatestFrame | None:
        """The latest frame of this message, or None before the first."""
        return self._latest.get(message)

    def arrived(self, message: str) -> Sequence[LatestFrame]:
        """Every frame of this message since the tick before, as they came; often none."""
        return self._arrived.get(message, ())

    def judged(self, message: str) -> Sequence[LatestFrame]:
        """Frames that a tick judges: all since the tick before, else the latest one, if any."""
        frames = self._arrived.get(message)
        if frames is not None:
            return frames
        latest = self._latest.get(message)
        return () if latest is None else (latest,)

    def age_ns(self, message: str) -> int | None:
        """Time since the arrival, never below 0; None before the first frame."""
        latest = self._latest.get(message)
        return None if latest is None else max(0, self.now_ns - latest.arrival_ns)

    def stale(self, message: str) -> bool:
        """True where the message never came, is too old, or its stamp lies in the future."""
        return message not in self._fresh

    def stale_messages(self) -> list[str]:
        """The names of all messages that are stale, in the protocol's order."""
        fresh = self._fresh
        if len(fresh) == len(self._specs):
            return []
        return [name for name in self._specs if name not in fresh]

    def reading(self, message: str, signal: str) -> Reading:
        """One signal; KeyError where the protocol has none of that name."""
        index = self.index(message, signal)
        return self._reading(message, index, self._specs[message].signals[index])

    def good_values(self, message: str, signal: str) -> Sequence[float]:
        """A signal's values that are to be judged; none where one of them cannot be relied upon."""
        if message not in self._fresh:
            return ()
        values, index = [], self.index(message, signal)
        for frame in self.judged(message):
            if frame.decoded.marks >> index & 1:
                return ()
            values.append(frame.decoded.values[index])
        return values

    def codes(self, message: str, signals: tuple[str, ...]) -> Sequence[tuple[int, ...]]:
        """Codes of these signals that are to be judged, a row for each frame, however old.

        Of frames that differ the codes of each signal are ordered, the highest in the last row;
        of those that do not there is one row. Two signals at least.
        """
        pick = self._pickers.get((message, signals)) or self._picker(message, signals)
        frames = self.judged(message)
        rows = [pick(frame.decoded.raws) for frame in frames]
        if len(frames) < 2:
            return rows
        if len(set(rows)) < 2:
            return rows[:1]
        return list(zip(*map(sorted, zip(*rows, strict=True)), strict=True))

    def _picker(
        self, message: str, signals: tuple[str, ...]
    ) -> Callable[[tuple[int, ...]], tuple[int, ...]]:
        indexes = self._indexes[message]
        picker = itemgetter(*[indexes[signal] for signal in signals])
        self._pickers[message, signals] = picker
        return picker

    def code_name(self, message: str, signal: str, raw: int) -> str | None:
        """The protocol's name of a code; None where it is reserved."""
        return self._specs[message].signals[self.index(message, signal)].names.get(raw)

    def index(self, message: str, signal: str) -> int:
        """Index of a signal in its message's values; KeyError where there is none of that name."""
        index = self._indexes[message].get(signal)
        if index is None:
            raise KeyError(f"{message} has no signal {signal}")
        return index

    def readings(self, message: str) -> tuple[Reading, ...]:
        signals = self._specs[message].signals
        return tuple(self._reading(message, i, signal) for i, signal in enumerate(signals))

    def marked(self, message: str) -> tuple[tuple[str, int], ...]:
        """Name and code of each signal out of range or saturated in a frame to be judged."""
        marked: dict[str, int] = {}
        for frame in self.judged(message):
            marks, raws = frame.decoded.marks, frame.decoded.raws
            if marks:
                names = enumerate(self._specs[message].signal_names)
                marked.update((name, raws[i]) for i, name in names if marks >> i & 1)
        return tuple(marked.items())

    def _reading(self, message: str, index: int, signal: SignalSpec) -> Reading:
        latest = self._latest.get(message)
        if latest is None:
            return Reading(signal.name, None, None, signal.unit, Quality.NEVER, None)
        raw = latest.decoded.raws[index]
        quality = Quality.STALE if self.stale(message) else mark(latest.decoded, index, signal)
        return Reading(
            signal.name,
            latest.decoded.values[index],
            raw,
            signal.unit,
            quality,
            self.age_ns(message),
            signal.names.get(raw),
        )


def mark(decoded: Decoded, index: int, signal: SignalSpec) -> Quality:
    """GOOD, OUT_OF_RANGE or SATURATED: quality of a signal in its frame."""
    if not decoded.marks >> index & 1:
        return Quality.GOOD
    saturated = decoded.raws[index] == signal.saturated_raw
    return Quality.SATURATED if saturated else Quality.OUT_OF_RANGE
