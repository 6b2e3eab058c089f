"""Pedals on CAN: frames of the vehicle's pedal node as demands (docs/safety.md, Pedals).

frames = PedalFrames(settings.pedals, codec)
for frame in received:                         # since the last tick, as they came
    demand = frames.demand_of(frame, now_ns)   # None: it is no demand
observation = frames.observe(now_ns)           # once a tick: what there is to tell
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from vcu_gateway.core.can_pedals import CanPedals, PedalReader, PedalReading
from vcu_gateway.core.codec import Codec, Decoded
from vcu_gateway.core.demand import CONTROLLERS, RELEASED_PCT, ControllerDemand, ControllerDemands
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.units import NS_PER_MS

PEDALS_SOURCE = "pedals"
"""Owner of the demands that frames are; no other source may use the name while there are some."""

_DOUBT_MAX_NS = 100 * NS_PER_MS
_RELEASED_NS = 1_000 * NS_PER_MS
_EXPIRY_PERIODS, _EXPIRY_MIN_MS, _EXPIRY_MAX_MS = 3, 60, 200
_UNTIL_RELEASED = "until both tracks are below 5 % for 1 s"


class PedalFault(Enum):
    """Reason for which a frame is no demand; counted beside those of the codec."""

    ORDER = "pedal_order"
    CHECKSUM = "pedal_checksum"
    COUNTER = "pedal_counter"


_FAULT_TEXTS = {
    PedalFault.ORDER: "older than the frame before",
    PedalFault.CHECKSUM: "checksum wrong",
    PedalFault.COUNTER: "counter not the next one",
}


class PedalDemand(NamedTuple):
    """Demand of one frame.

    Attributes:
        sequence: number among the demands of the pedals.
        made_ns: its arrival.
        known: it is believed; else its throttle is 0 and releases nothing.
        resumed: the demand before it had expired by then, or there was none.
    """

    controllers: ControllerDemands
    sequence: int
    made_ns: int
    known: bool
    resumed: bool


class PedalObservation(NamedTuple):
    """What there is to tell of the pedals in a tick.

    Attributes:
        bad_frames: frames in a row that were no demand, at the most in this tick; `bad` says why.
        doubts: what is not believed, by signal.
    """

    message: str
    bad_frames: int
    bad: str
    doubts: Mapping[str, str]


class PedalState(NamedTuple):
    """What the pedals say now, by their last frame that was a demand, to be shown.

    Attributes:
        throttle_pct, track2_pct, brake_pct: what each asks for; None where that is not known, also
            where such a frame came too long ago, or the message has none of it.
        doubts: why they are not believed, each a sentence; none where they are.
    """

    message: str
    throttle_pct: float | None
    track2_pct: float | None
    brake_pct: float | None
    doubts: tuple[str, ...]

    @property
    def difference_pct(self) -> float | None:
        """By how much the tracks differ; None where not both are known."""
        if self.throttle_pct is None or self.track2_pct is None:
            return None
        return abs(self.throttle_pct - self.track2_pct)

    def sentence(self) -> str:
        """What is known of them, and why they are not believed."""
        shown = (
            ("throttle", self.throttle_pct),
            ("second track", self.track2_pct),
            ("difference", self.difference_pct),
            ("brake", self.brake_pct),
        )
        known = ", ".join(f"{name} {pct:.0f} %" for name, pct in shown if pct is not None)
        return "; ".join(text for text in (known, *self.doubts) if text)


def expiry_ms(period_ms: int) -> int:
    """Age from which a demand of the pedals has expired, of a message of this period."""
    return min(_EXPIRY_MAX_MS, max(_EXPIRY_MIN_MS, _EXPIRY_PERIODS * period_ms))


@dataclass
class PedalMemory:
    """What a frame is held against: the ones before it, and for how long something lasts.

    Attributes:
        arrival_ns, counter: of the frame received last.
        demand_ns: arrival of the last frame that was a demand.
        run, worst_run: frames in a row that were none, now and at the most in this tick.
        doubted_since_ns: arrival of the first of the frames that are not believed.
        doubts: of the last of them; `told` of all of them since the last tick.
        latched: none is believed until both tracks were released; since when they are.
    """

    arrival_ns: int | None = None
    counter: int | None = None
    demand_ns: int | None = None
    sequence: int = 0
    reverse: bool = False
    run: int = 0
    worst_run: int = 0
    fault: PedalFault | None = None
    doubted_since_ns: int | None = None
    doubts: Mapping[str, str] = field(default_factory=dict)
    told: dict[str, str] = field(default_factory=dict)
    latched: bool = False
    released_since_ns: int | None = None
    rejected: dict[PedalFault, int] = field(default_factory=lambda: dict.fromkeys(PedalFault, 0))


class PedalFrames:
    """Demands of the pedals' frames, and what is remembered of them from tick to tick.

    Equal ones remember the same.
    """

    def __init__(self, pedals: CanPedals | None, codec: Codec) -> None:
        self._reader: PedalReader | None = None
        self._expiry_ns = 0
        self._memory = PedalMemory()
        self._last: Decoded | None = None
        if pedals is not None:
            message = codec.by_name[pedals.message]
            self._reader = PedalReader(pedals, message)
            self._expiry_ns = expiry_ms(message.spec.period_ms or 0) * NS_PER_MS

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PedalFrames) and self._memory == other._memory

    __hash__ = None  # type: ignore[assignment]  # what it remembers changes

    @property
    def rejected(self) -> Mapping[PedalFault, int]:
        """Frames that were no demand, by reason; empty without pedals."""
        return {} if self._reader is None else self._memory.rejected

    def ttl_ms(self, period_ns: int) -> int:
        """How long a demand counts: a tick's period more, what came meanwhile is not read yet."""
        return (self._expiry_ns + period_ns) // NS_PER_MS

    def silent(self, now_ns: int) -> bool:
        """No frame that is a demand came for too long."""
        demand_ns = self._memory.demand_ns
        return demand_ns is None or now_ns - demand_ns > self._expiry_ns

    def demand_of(self, frame: Frame, now_ns: int) -> PedalDemand | None:
        """Demand of the next frame; None where it is none. `now_ns` is that of the tick."""
        reader, memory = self._reader, self._memory
        if reader is None:
            return None
        arrival_ns = min(frame.arrival_ns, now_ns)
        decoded = reader.decode(frame.data)
        if fault := self._fault_of(reader, decoded, frame.data, arrival_ns):
            memory.fault = fault
            memory.rejected[fault] += 1
            memory.run += 1
            memory.worst_run = max(memory.worst_run, memory.run)
            return None
        memory.run, self._last = 0, decoded
        if resumed := self.silent(arrival_ns):
            memory.doubted_since_ns = memory.released_since_ns = None
        memory.demand_ns = arrival_ns
        memory.sequence += 1
        reading = reader.read(decoded)
        if reading.reverse is not None:
            memory.reverse = reading.reverse
        known = self._believed(reading, arrival_ns)
        one = _demand(reader.pedals, reading, known=known, reverse=memory.reverse)
        both = dict.fromkeys(CONTROLLERS, one)
        return PedalDemand(both, memory.sequence, arrival_ns, known, resumed)

    def _fault_of(
        self, reader: PedalReader, decoded: Decoded, data: bytes | bytearray, arrival_ns: int
    ) -> PedalFault | None:
        memory = self._memory
        if memory.arrival_ns is not None and arrival_ns < memory.arrival_ns:
            return PedalFault.ORDER  # it is no next one of anything
        before, counter = memory.counter, reader.counter(decoded)
        memory.arrival_ns, memory.counter = arrival_ns, counter
        if not reader.checksum_holds(data):
            return PedalFault.CHECKSUM
        return None if reader.follows(counter, before) else PedalFault.COUNTER

    def _believed(self, reading: PedalReading, at_ns: int) -> bool:
        memory = self._memory
        self._latch(at_ns)  # also where this frame ends the doubt
        if reading.doubts:
            if memory.doubted_since_ns is None:
                memory.doubted_since_ns = at_ns
            memory.doubts, memory.released_since_ns = reading.doubts, None
            memory.told.update(reading.doubts)
            return False
        memory.doubted_since_ns = None
        if memory.latched:
            self._release(reading, at_ns)
        return not memory.latched

    def _latch(self, now_ns: int) -> None:
        since_ns = self._memory.doubted_since_ns
        if since_ns is not None and now_ns - since_ns > _DOUBT_MAX_NS:
            self._memory.latched = True

    def _release(self, reading: PedalReading, at_ns: int) -> None:
        memory = self._memory
        if max(reading.throttle_pct, reading.track2_pct or 0.0) >= RELEASED_PCT:
            memory.released_since_ns = None
        elif memory.released_since_ns is None:
            memory.released_since_ns = at_ns
        elif at_ns - memory.released_since_ns >= _RELEASED_NS:
            memory.latched = False

    def observe(self, now_ns: int) -> PedalObservation | None:
        """What there is to tell in this tick, once a tick; None where all is well."""
        memory = self._memory
        self._latch(now_ns)
        run, memory.worst_run = memory.worst_run, memory.run
        doubts: dict[str, str] = {}
        if memory.latched:
            doubts = dict.fromkeys(memory.doubts, _UNTIL_RELEASED)
        if memory.doubted_since_ns is not None:
            doubts.update(memory.doubts)
        doubts.update(memory.told)
        memory.told = {}
        if self._reader is None or not (run or doubts):
            return None
        bad = "" if memory.fault is None else _FAULT_TEXTS[memory.fault]
        return PedalObservation(self._reader.pedals.message, run, bad, doubts)

    def now(self, now_ns: int, period_ns: int) -> PedalState | None:
        """What the pedals say; None without pedals. From any thread, and changes nothing.

        Between two ticks, so that what came since the last one is not read yet.
        """
        reader, memory = self._reader, self._memory
        if reader is None:
            return None
        pedals, doubts = reader.pedals, []
        last = None if self.silent(now_ns - period_ns) else self._last
        if memory.run and memory.fault is not None:
            doubts.append(_FAULT_TEXTS[memory.fault])
        if last is None:
            doubts.append("no frame that is a demand")
            return PedalState(pedals.message, None, None, None, tuple(doubts))
        reading = reader.read(last)
        doubts += [f"{signal} {text}" for signal, text in reading.doubts.items()]
        if memory.latched:
            doubts.append(f"not believed {_UNTIL_RELEASED}")
        tracks = (
            (pedals.throttle, reading.throttle_pct),
            (pedals.throttle_track2, reading.track2_pct),
            (pedals.brake, reading.brake_pct),
        )
        throttle_pct, track2_pct, brake_pct = (
            None if track is None or track.signal in reading.doubts else pct
            for track, pct in tracks
        )
        return PedalState(pedals.message, throttle_pct, track2_pct, brake_pct, tuple(doubts))


def _demand(
    pedals: CanPedals, reading: PedalReading, *, known: bool, reverse: bool
) -> ControllerDemand:
    """Demand of each controller; without throttle where the frame is not believed."""
    coasting = known and reading.coast_pct > reading.brake_pct
    return ControllerDemand(
        throttle_pct=reading.throttle_pct if known else 0.0,
        brake_pct=reading.coast_pct if coasting else reading.brake_pct,
        power_mode=pedals.power_mode,
        motor_reverse=reverse,
        regen_brake=pedals.regen_brake or coasting,
        throttle_track2_pct=reading.track2_pct if known or reading.track2_pct is None else 0.0,
    )
