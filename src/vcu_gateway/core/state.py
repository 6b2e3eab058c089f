"""State store: the latest frame of each message, and every frame since the last tick.

The ticking thread replaces whole immutable records; any thread reads the latest ones without a
lock. Each record also goes into a list of arrivals, which the next tick takes.
"""

from collections.abc import Iterable, Mapping, Sequence

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.snapshot import LatestFrame, Pickers, Snapshot
from vcu_gateway.core.spec import MessageSpec

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

    def put(self, name: str, decoded: Decoded, arrival_ns: int) -> bool:
        """Keep a decoded frame; False where a newer one is known and stays the latest."""
        last = self._latest.get(name)
        marked = 1 if decoded.marks else 0
        if last is None:
            latest = self._latest[name] = LatestFrame(decoded, arrival_ns, 1, marked, None)
            self._note_arrival(name, latest)
            return True
        interval_ns = arrival_ns - last.arrival_ns
        if interval_ns < 0:
            self.out_of_order += 1
            self._note_arrival(name, last._replace(decoded=decoded, arrival_ns=arrival_ns))
            return False
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
        return True

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
        latest = self._latest.copy()
        return Snapshot(
            now_ns,
            self._specs,
            self._indexes,
            self._pickers,
            latest,
            arrived,
            self._stale_after_ns,
        )
