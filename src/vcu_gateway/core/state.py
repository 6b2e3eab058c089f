"""The latest message of each kind, and all that is known at one instant.

One writer (the receive thread) replaces whole immutable records; any thread reads them
without a lock.
"""

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import NamedTuple

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.spec import MessageSpec, SignalSpec

_NS_PER_MS = 1_000_000
_PERIOD_SMOOTHING = 8

LIFE_SIGNAL = "LifeSignal"
"""The signal that must toggle in every frame of its message, where there is one."""

# Stamps come from another clock reading than the tick's; more than this ahead is no stamp.
FUTURE_TOLERANCE_NS = 20 * _NS_PER_MS


class Quality(Enum):
    """What a value is worth."""

    GOOD = "good"
    OUT_OF_RANGE = "out of range"
    SATURATED = "saturated"
    STALE = "stale"
    NEVER = "never"


class Latest(NamedTuple):
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


class Store:
    """The latest frame of every message.

    A frame older than the one it follows does not replace it: the newest stamp wins.
    """

    def __init__(self, messages: Iterable[MessageSpec], stale_after_ns: Mapping[str, int]) -> None:
        self._specs = {message.name: message for message in messages}
        self._stale_after_ns = dict(stale_after_ns)
        self._latest: dict[str, Latest] = {}
        self._indexes = {
            name: {signal: i for i, signal in enumerate(spec.signal_names)}
            for name, spec in self._specs.items()
        }
        self.out_of_order = 0

    def put(self, name: str, decoded: Decoded, arrival_ns: int) -> bool:
        """Keep a decoded frame; False, and nothing changed, where a newer one is known."""
        last = self._latest.get(name)
        marked = 1 if decoded.marks else 0
        if last is None:
            self._latest[name] = Latest(decoded, arrival_ns, 1, marked, None)
            return True
        interval_ns = arrival_ns - last.arrival_ns
        if interval_ns < 0:
            self.out_of_order += 1
            return False
        period_ns = last.period_ns
        if period_ns is None:
            period_ns = interval_ns
        else:
            period_ns += (interval_ns - period_ns) // _PERIOD_SMOOTHING
        repeats = 0
        life = self._indexes[name].get(LIFE_SIGNAL)
        if life is not None and decoded.raws[life] == last.decoded.raws[life]:
            repeats = last.life_repeats + 1
        self._latest[name] = Latest(
            decoded,
            arrival_ns,
            last.frame_count + 1,
            last.marked_count + marked,
            period_ns,
            repeats,
        )
        return True

    def snapshot(self, now_ns: int) -> "Snapshot":
        """All that is known at this instant; later frames do not change it."""
        latest = self._latest.copy()
        return Snapshot(now_ns, self._specs, self._indexes, latest, self._stale_after_ns)


class Snapshot:
    """All that is known at one instant."""

    __slots__ = ("_indexes", "_latest", "_specs", "_stale_after_ns", "now_ns")

    def __init__(
        self,
        now_ns: int,
        specs: Mapping[str, MessageSpec],
        indexes: Mapping[str, Mapping[str, int]],
        latest: Mapping[str, Latest],
        stale_after_ns: Mapping[str, int],
    ) -> None:
        self.now_ns = now_ns
        self._specs = specs
        self._indexes = indexes
        self._latest = latest
        self._stale_after_ns = stale_after_ns

    @property
    def messages(self) -> tuple[MessageSpec, ...]:
        """Every message that the store keeps."""
        return tuple(self._specs.values())

    def latest(self, message: str) -> Latest | None:
        """The latest frame of this message, or None before the first."""
        return self._latest.get(message)

    def age_ns(self, message: str) -> int | None:
        """Time since the arrival, never below 0; None before the first frame."""
        latest = self._latest.get(message)
        return None if latest is None else max(0, self.now_ns - latest.arrival_ns)

    def stale(self, message: str) -> bool:
        """True where the message never came, is too old, or its stamp lies in the future."""
        latest = self._latest.get(message)
        if latest is None:
            return True
        age_ns = self.now_ns - latest.arrival_ns
        return age_ns > self._stale_after_ns[message] or age_ns < -FUTURE_TOLERANCE_NS

    def reading(self, message: str, signal: str) -> Reading:
        """One signal; KeyError where the protocol has none of that name."""
        index = self._index(message, signal)
        return self._reading(message, index, self._specs[message].signals[index])

    def codes(self, message: str, signals: Iterable[str]) -> tuple[int, ...] | None:
        """The latest codes of these signals, however old; None before the first frame."""
        latest = self._latest.get(message)
        if latest is None:
            return None
        indexes, raws = self._indexes[message], latest.decoded.raws
        return tuple([raws[indexes[signal]] for signal in signals])

    def _index(self, message: str, signal: str) -> int:
        index = self._indexes[message].get(signal)
        if index is None:
            raise KeyError(f"{message} has no signal {signal}")
        return index

    def readings(self, message: str) -> tuple[Reading, ...]:
        """All signals of a message, in the protocol's order."""
        signals = self._specs[message].signals
        return tuple(self._reading(message, i, signal) for i, signal in enumerate(signals))

    def marked(self, message: str) -> tuple[tuple[str, int], ...]:
        """Name and code of each signal out of range or saturated in the latest frame."""
        latest = self._latest.get(message)
        if latest is None or not latest.decoded.marks:
            return ()
        names, decoded = self._specs[message].signal_names, latest.decoded
        return tuple(
            (name, decoded.raws[i]) for i, name in enumerate(names) if decoded.marks >> i & 1
        )

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
    """GOOD, OUT_OF_RANGE or SATURATED: what the frame itself says of a signal."""
    if not decoded.marks >> index & 1:
        return Quality.GOOD
    saturated = decoded.raws[index] == signal.saturated_raw
    return Quality.SATURATED if saturated else Quality.OUT_OF_RANGE
