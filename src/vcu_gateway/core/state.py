"""State store: the messages received, how old they may be, and the snapshot that a tick judges.

The ticking thread replaces whole immutable records; any thread reads the latest ones without a
lock. Each record also goes into a list of arrivals, which the next tick takes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from operator import itemgetter
from typing import NamedTuple

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.units import NS_PER_MS

_NEVER_NS = 2**62

# From this period on (ms): stale after so many periods, in tenths.
_STALE_TENTHS = ((500, 32), (100, 30), (50, 40), (0, 100))
_LATE_TENTHS = 22


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Ages, from the arrival stamp, beyond which a message is late or stale."""

    late_after_ns: int
    stale_after_ns: int


def deadlines(
    message: MessageSpec, late_after_ms: Mapping[str, int], stale_after_ms: Mapping[str, int]
) -> Deadlines:
    """The deadlines of a message; an override by name wins over what the period gives.

    A message without a period is never late or stale.
    """
    if message.period_ms is None:
        late_ns = stale_ns = _NEVER_NS
    else:
        stale_ns = message.period_ms * _stale_tenths(message.period_ms) * NS_PER_MS // 10
        late_ns = min(message.period_ms * _LATE_TENTHS * NS_PER_MS // 10, stale_ns)
    if message.name in stale_after_ms:
        stale_ns = stale_after_ms[message.name] * NS_PER_MS
    if message.name in late_after_ms:
        late_ns = late_after_ms[message.name] * NS_PER_MS
    return Deadlines(min(late_ns, stale_ns), stale_ns)


def _stale_tenths(period_ms: int) -> int:
    return next(tenths for least_ms, tenths in _STALE_TENTHS if period_ms >= least_ms)


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
    """One signal at one instant; value and raw are None where it never came."""

    name: str
    value: float | None
    raw: int | None
    unit: str
    quality: Quality
    code_name: str | None = None


# Takes some signals' codes out of all codes of a message, by message and signals: an itemgetter
# made once takes a fifth of the time of looking for each signal in every tick.
Pickers = dict[tuple[str, tuple[str, ...]], Callable[[tuple[int, ...]], tuple[int, ...]]]


class Snapshot:
    """State of every message at one instant."""

    __slots__ = (*("_arrived", "_fresh", "_indexes", "_latest", "_pickers", "_specs"), "now_ns")

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

    def fresh(self, message: str) -> Sequence[LatestFrame]:
        """Frames that a tick judges; none where the message is stale."""
        if message not in self._fresh:
            return ()
        frames = self._arrived.get(message)
        return (self._latest[message],) if frames is None else frames

    def changed(self, said: dict[str, Decoded | None]) -> list[str]:
        """Messages of these that do not say what they said before, in one fresh frame.

        `said` has then what each says now: None where there are several frames to judge or none.
        """
        arrived, fresh, latest = self._arrived, self._fresh, self._latest
        changed = []
        for name, before in said.items():  # in every tick: a comprehension is a call more
            now = None
            if name in fresh:
                frames = arrived.get(name)
                if frames is None:
                    now = latest[name].decoded
                elif len(frames) == 1:
                    now = frames[0].decoded
            if now is None or now != before:
                said[name] = now
                changed.append(name)
        return changed

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
        return self._reading(message, self.index(message, signal))

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

    def indexes(self, message: str) -> Mapping[str, int]:
        """Index of each signal in its message's values."""
        return self._indexes[message]

    def index(self, message: str, signal: str) -> int:
        """Index of a signal in its message's values; KeyError where there is none of that name."""
        index = self._indexes[message].get(signal)
        if index is None:
            raise KeyError(f"{message} has no signal {signal}")
        return index

    def readings(self, message: str) -> tuple[Reading, ...]:
        return tuple(self._reading(message, i) for i in range(len(self._specs[message].signals)))

    def marked(self, message: str) -> tuple[tuple[str, int], ...]:
        """Name and code of each signal out of range or saturated in a frame to be judged."""
        marked: dict[str, int] = {}
        for frame in self.judged(message):
            marks, raws = frame.decoded.marks, frame.decoded.raws
            if marks:
                names = enumerate(self._specs[message].signal_names)
                marked.update((name, raws[i]) for i, name in names if marks >> i & 1)
        return tuple(marked.items())

    def _reading(self, message: str, index: int) -> Reading:
        latest, signal = self._latest.get(message), self._specs[message].signals[index]
        if latest is None:
            return Reading(signal.name, None, None, signal.unit, Quality.NEVER)
        value, raw = latest.decoded.values[index], latest.decoded.raws[index]
        quality = Quality.STALE if self.stale(message) else mark(latest.decoded, index, signal)
        return Reading(signal.name, value, raw, signal.unit, quality, signal.names.get(raw))


def mark(decoded: Decoded, index: int, signal: SignalSpec) -> Quality:
    """GOOD, OUT_OF_RANGE or SATURATED: quality of a signal in its frame."""
    if not decoded.marks >> index & 1:
        return Quality.GOOD
    saturated = decoded.raws[index] == signal.saturated_raw
    return Quality.SATURATED if saturated else Quality.OUT_OF_RANGE


_PERIOD_SMOOTHING = 8

LIFE_SIGNAL = "LifeSignal"
"""The signal that must toggle in every frame of its message, where there is one."""

MOST_ARRIVALS = 4096
"""Frames of one message that are kept for a tick: more than a bus of 1 Mbit/s carries in 0.4 s,
and by then the tick's own lateness has ended the drive."""


class Store:
    """The latest frame of every message, and all frames since they were last taken.

    A frame older than the one it follows does not replace it: the newest stamp wins. It is
    judged like any other.

    Attributes:
        out_of_order: frames older than the one before them.
        unjudged: frames of which so many came that the next tick could not judge them all.
    """

    def __init__(self, messages: Iterable[MessageSpec], stale_after_ns: Mapping[str, int]) -> None:
        self._specs = {message.name: message for message in messages}
        self._stale_after_ns = dict(stale_after_ns)
        self._latest: dict[str, LatestFrame] = {}
        self._arrived: dict[str, list[LatestFrame]] = {}
        self._pickers: Pickers = {}
        self._indexes = {
            name: {signal: i for i, signal in enumerate(spec.signal_names)}
            for name, spec in self._specs.items()
        }
        self._life_indexes = {
            name: indexes[LIFE_SIGNAL]
            for name, indexes in self._indexes.items()
            if LIFE_SIGNAL in indexes
        }
        self.out_of_order = 0
        self.unjudged = 0

    def put(self, name: str, decoded: Decoded, arrival_ns: int) -> None:
        """Keep a decoded frame; where a newer one is known that stays the latest."""
        last = self._latest.get(name)
        marked = 1 if decoded.marks else 0
        if last is None:
            latest = self._latest[name] = LatestFrame(decoded, arrival_ns, 1, marked, None)
            self._note_arrival(name, latest)
            return
        interval_ns = arrival_ns - last.arrival_ns
        if interval_ns < 0:
            self.out_of_order += 1
            self._note_arrival(name, last._replace(decoded=decoded, arrival_ns=arrival_ns))
            return
        period_ns = last.period_ns
        if period_ns is None:
            period_ns = interval_ns
        else:
            period_ns += (interval_ns - period_ns) // _PERIOD_SMOOTHING
        repeats = 0
        life = self._life_indexes.get(name)
        if life is not None and decoded.raws[life] == last.decoded.raws[life]:
            repeats = last.life_repeats + 1
        frames, marks = last.frame_count + 1, last.marked_count + marked
        latest = LatestFrame(decoded, arrival_ns, frames, marks, period_ns, repeats)
        self._latest[name] = latest
        self._note_arrival(name, latest)

    def _note_arrival(self, name: str, frame: LatestFrame) -> None:
        frames = self._arrived.get(name)
        if frames is None:
            self._arrived[name] = [frame]
        elif len(frames) < MOST_ARRIVALS:
            frames.append(frame)
        else:
            self.unjudged += 1

    def snapshot(self, now_ns: int) -> Snapshot:
        """State of every message at this instant; later frames do not change it."""
        return self._snapshot(now_ns, {})

    def take(self, now_ns: int) -> Snapshot:
        """The same with every frame since the last call: for the tick, which judges them."""
        arrived, self._arrived = self._arrived, {}
        return self._snapshot(now_ns, arrived)

    def _snapshot(self, now_ns: int, arrived: Mapping[str, Sequence[LatestFrame]]) -> Snapshot:
        specs, indexes, latest = self._specs, self._indexes, self._latest.copy()
        stale_after_ns = self._stale_after_ns
        return Snapshot(now_ns, specs, indexes, self._pickers, latest, arrived, stale_after_ns)
