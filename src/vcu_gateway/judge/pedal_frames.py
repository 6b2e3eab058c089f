"""Frames of pedals on CAN as the demands that they are: docs/safety.md, Pedals, read again."""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from vcu_gateway.judge.arrivals import BusFrame
from vcu_gateway.judge.demands import GrantedDemand
from vcu_gateway.judge.limits import JudgedDemand, JudgedPedals, JudgedTrack
from vcu_gateway.judge.tuning_rules import value_at
from vcu_gateway.judge.wire import CONTROLLERS, LENGTH, MATCH, MS

PEDALS = "pedals"
_BEYOND_PCT = 10.0 + 1e-9
_DOUBT_NS, _RELEASED_NS, _RELEASED_PCT = 100 * MS, 1000 * MS, 5.0
_SPEED_RPM, _POWER_W = 12_000.0, 60_000.0


class PedalsDemand(NamedTuple):
    """Demand of a frame; `resumed`: the one before had expired, not `known`: not believed."""

    demand: GrantedDemand
    known: bool
    resumed: bool


class PedalsReading:
    """Pedals from tick to tick; what was before a recording's begin is unknown and excuses."""

    def __init__(self, pedals: JudgedPedals) -> None:
        self._pedals = pedals
        self._expiry_ns = MS * max(60, min(200, 3 * pedals.period_ms))
        self._frames: list[BusFrame] = []
        self._arrival_ns: int | None = None
        self._counter: int | None = None
        self._demand_ns: int | None = None
        self._doubt_ns: int | None = None
        self._release_ns: int | None = None
        self._latched = self._reverse = False

    def collect(self, frames: Iterable[BusFrame]) -> None:
        """Keep those of the pedals among these frames for the tick."""
        key = self._pedals.can_id & MATCH
        for one in frames:
            odd = one.error or one.remote or one.own_echo or not one.extended
            if not odd and one.can_id & MATCH == key and len(one.data) == LENGTH:
                self._frames.append(one)

    def demands(self, now_ns: int, tick_ms: float) -> Iterator[PedalsDemand]:
        """Demand of each frame since the last tick; those that are none are left out."""
        frames, self._frames = self._frames, []
        for one in frames:
            at_ns = min(one.arrival_ns, now_ns)
            if self._is_demand(bytes(one.data), at_ns):
                yield self._read(int.from_bytes(one.data, "little"), at_ns, tick_ms)
        self._note_doubt(now_ns)

    def silent(self, now_ns: int) -> bool:
        return self._demand_ns is None or now_ns - self._demand_ns > self._expiry_ns

    def _is_demand(self, data: bytes, at_ns: int) -> bool:
        if self._arrival_ns is not None and at_ns < self._arrival_ns:
            return False
        self._arrival_ns = at_ns
        before, signal = self._counter, self._pedals.counter
        follows = True
        if signal is not None:
            self._counter = signal.raw(int.from_bytes(data, "little"))
            if before is not None:
                expected = signal.lowest if before >= signal.highest else before + 1
                follows = self._counter == expected
        return follows and _sums_up(data, self._pedals.checksum)

    def _read(self, bits: int, at_ns: int, tick_ms: float) -> PedalsDemand:
        pedals = self._pedals
        resumed = self.silent(at_ns)
        if resumed:
            self._doubt_ns = self._release_ns = None
        self._demand_ns = at_ns
        first, second, brake = (
            _travel_pct(track, bits) for track in (pedals.throttle, pedals.track2, pedals.brake)
        )
        turn = 0 if pedals.reverse is None else pedals.reverse.known_raw(bits)
        if turn in (0, 1):
            self._reverse = turn == 1
        missing = [
            track is not None and travel is None
            for track, travel in (
                (pedals.throttle, first), (pedals.track2, second), (pedals.brake, brake),
            )
        ]  # fmt: skip
        tracks = [self._asked(one) for one in (first, second) if one is not None]
        known = self._believes(any(missing) or turn not in (0, 1), tracks, at_ns)
        braked, regen = self._asked(brake), pedals.regen_brake
        if known and pedals.coast:
            travels = [one for one in (first, second) if one is not None]
            coast = value_at(pedals.coast, max(travels))
            if coast > braked:
                braked, regen = coast, True
        second_pct = None if pedals.track2 is None else self._asked(second) if known else 0.0
        one = JudgedDemand(
            self._asked(first) if known else 0.0, braked, pedals.power_mode, self._reverse,
            regen, _SPEED_RPM, _POWER_W, second_pct,
        )  # fmt: skip
        ttl_ms = round(self._expiry_ns / MS + tick_ms)
        both = dict.fromkeys(CONTROLLERS, one)
        return PedalsDemand(GrantedDemand(PEDALS, both, at_ns, ttl_ms), known, resumed)

    def _asked(self, travel_pct: float | None) -> float:
        zone = self._pedals.dead_zone_pct
        if travel_pct is None or travel_pct <= zone:
            return 0.0
        return min(100.0, (travel_pct - zone) * 100.0 / (100.0 - 2 * zone))

    def _note_doubt(self, now_ns: int) -> None:
        if self._doubt_ns is not None and now_ns - self._doubt_ns > _DOUBT_NS:
            self._latched = True

    def _believes(self, doubted: bool, tracks: list[float], at_ns: int) -> bool:
        self._note_doubt(at_ns)
        if doubted:
            self._doubt_ns = at_ns if self._doubt_ns is None else self._doubt_ns
            self._release_ns = None
            return False
        self._doubt_ns = None
        if not self._latched or max(tracks) >= _RELEASED_PCT:
            self._release_ns = None
        elif self._release_ns is None:
            self._release_ns = at_ns
        elif at_ns >= self._release_ns + _RELEASED_NS:
            self._latched = False
        return not self._latched


def _travel_pct(track: JudgedTrack | None, bits: int) -> float | None:
    """Place in the travel; None where it is not known, or too far beyond an end."""
    raw = None if track is None else track.signal.known_raw(bits)
    if track is None or raw is None:
        return None
    value = raw * track.signal.factor + track.signal.offset
    travel = 100.0 * (value - track.released) / (track.pressed - track.released)
    return travel if -_BEYOND_PCT <= travel <= 100.0 + _BEYOND_PCT else None


def _sums_up(data: bytes, checksum: tuple[int, str] | None) -> bool:
    if checksum is None:
        return True
    own, kind = checksum
    crc, xored, added = 0xFF, 0, 0
    for place, byte in enumerate(data):
        if place == own:
            continue
        xored, added, crc = xored ^ byte, added + byte & 0xFF, crc ^ byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    made: Mapping[str, int] = {"xor": xored, "sum": added, "sae_j1850": crc ^ 0xFF}
    return data[own] == made[kind]
