"""Pedals on CAN as the configuration has them, and what one frame of them says.

What it counts for after the frames before it: core/pedal_frames.py (docs/safety.md, Pedals).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import reduce
from operator import xor
from typing import Any, Literal, NamedTuple

from vcu_gateway.core.codec import Decoded, MessageCodec
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import PowerMode

_BEYOND_MAX_PCT = 10.0
_ROUNDING_PCT = 1e-9  # a value at the very limit is not beyond it

ChecksumKind = Literal["xor", "sum", "sae_j1850"]


@dataclass(frozen=True, slots=True)
class PedalTrack:
    """Signal of a pedal, and its value at both ends of the travel, in its own unit."""

    signal: str
    released: float
    pressed: float

    def travel_pct(self, value: float) -> float:
        return (value - self.released) / (self.pressed - self.released) * 100.0


@dataclass(frozen=True, slots=True)
class PedalChecksum:
    """Signal of a checksum over the other bytes of its frame."""

    signal: str
    kind: ChecksumKind


@dataclass(frozen=True, slots=True, kw_only=True)
class CanPedals:
    """Message that carries the pedals, and what its signals mean; in the order of a recording.

    Attributes:
        brake: None where the message has none; then brake over throttle is not watched.
        reverse: signal that is 1 for reverse; None: always forwards.
        coast_brake: travel (%) to Brake (%) of the demand; None is off.
    """

    message: str
    counter: str | None = None
    reverse: str | None = None
    power_mode: PowerMode = PowerMode.ECO
    regen_brake: bool = False
    dead_zone_pct: float = 3.0
    throttle: PedalTrack
    throttle_track2: PedalTrack | None = None
    brake: PedalTrack | None = None
    checksum: PedalChecksum | None = None
    coast_brake: Curve | None = None

    def asked_pct(self, travel_pct: float | None) -> float:
        """What a travel asks for: 0 and 100 % within the dead zones, linear between; of None 0."""
        if travel_pct is None:
            return 0.0
        zone_pct = self.dead_zone_pct
        share = (travel_pct - zone_pct) / (100.0 - 2 * zone_pct)
        return 100.0 * min(1.0, max(0.0, share))


class PedalReading(NamedTuple):
    """Pedals of one frame, whatever came before it; what is not known is 0.

    Attributes:
        track2_pct: None where the message has no second track.
        coast_pct: Brake that a released pedal asks for.
        reverse: None where it is not known.
        doubts: what is not to be believed, by signal.
    """

    throttle_pct: float
    track2_pct: float | None
    brake_pct: float
    coast_pct: float
    reverse: bool | None
    doubts: Mapping[str, str]


class PedalReader:
    """Decoder of a message of pedals.

    Attributes:
        decode: a frame's data to the signals that the rest takes.
    """

    def __init__(self, pedals: CanPedals, codec: MessageCodec) -> None:
        self.pedals = pedals
        self.decode = codec.decode
        self._indexes = {name: i for i, name in enumerate(codec.spec.signal_names)}
        self._checksum: tuple[int, ChecksumKind] | None = None
        if one := pedals.checksum:
            self._checksum = codec.spec.signal(one.signal).start_bit // 8, one.kind
        self._counter = None if pedals.counter is None else codec.spec.signal(pedals.counter)

    def counter(self, decoded: Decoded) -> int | None:
        """Counter of a frame; None where the message has none."""
        return None if self._counter is None else decoded.raws[self._indexes[self._counter.name]]

    def follows(self, counter: int | None, before: int | None) -> bool:
        """Whether this counter is the next one; nothing is held against the first."""
        if self._counter is None or before is None:
            return True
        wraps = before >= self._counter.raw_maximum
        return counter == (self._counter.raw_minimum if wraps else before + 1)

    def checksum_holds(self, data: bytes | bytearray) -> bool:
        if self._checksum is None:
            return True
        byte, kind = self._checksum
        return data[byte] == checksum_of(data[:byte] + data[byte + 1 :], kind)

    def read(self, decoded: Decoded) -> PedalReading:
        """What a frame says by itself."""
        pedals, curve = self.pedals, self.pedals.coast_brake
        doubts: dict[str, str] = {}
        first = self._travel_pct(pedals.throttle, decoded, doubts)
        second = self._travel_pct(pedals.throttle_track2, decoded, doubts)
        brake = self._travel_pct(pedals.brake, decoded, doubts)
        travels = [one for one in (first, second) if one is not None]
        return PedalReading(
            throttle_pct=pedals.asked_pct(first),
            track2_pct=None if pedals.throttle_track2 is None else pedals.asked_pct(second),
            brake_pct=pedals.asked_pct(brake),
            coast_pct=curve.at(max(travels)) if curve is not None and travels else 0.0,
            reverse=self._reverse(decoded, doubts),
            doubts=doubts,
        )

    def _travel_pct(
        self, track: PedalTrack | None, decoded: Decoded, doubts: dict[str, str]
    ) -> float | None:
        """Travel of a track; None, and a doubt, where it is not to be believed."""
        if track is None:
            return None
        index = self._indexes[track.signal]
        if decoded.marks >> index & 1:
            doubts[track.signal] = "not known"
            return None
        travel_pct = track.travel_pct(decoded.values[index])
        if max(-travel_pct, travel_pct - 100.0) > _BEYOND_MAX_PCT + _ROUNDING_PCT:
            doubts[track.signal] = f"at {travel_pct:.0f} % of its travel"
            return None
        return travel_pct

    def _reverse(self, decoded: Decoded, doubts: dict[str, str]) -> bool | None:
        name = self.pedals.reverse
        if name is None:
            return False
        index = self._indexes[name]
        raw = decoded.raws[index]
        if raw in (0, 1) and not decoded.marks >> index & 1:
            return raw == 1
        doubts[name] = f"code {raw} is neither forwards nor reverse"
        return None


def _crc_table() -> bytes:
    table = []
    for value in range(256):
        for _ in range(8):
            value = value << 1 ^ (0x11D if value & 0x80 else 0)  # noqa: PLW2901 - bit by bit
        table.append(value)
    return bytes(table)


_CRC_TABLE = _crc_table()


def checksum_of(data: bytes | bytearray, kind: ChecksumKind) -> int:
    """Checksum of these bytes, one byte; `sae_j1850` is its CRC-8."""
    if kind == "xor":
        return reduce(xor, data, 0)
    if kind == "sum":
        return sum(data) & 0xFF
    return reduce(lambda crc, byte: _CRC_TABLE[crc ^ byte], data, 0xFF) ^ 0xFF


def values(pedals: CanPedals) -> dict[str, Any]:
    """Values for JSON, by the keys of the configuration."""
    found = asdict(pedals) | {"power_mode": pedals.power_mode.name.lower()}
    curve = found.pop("coast_brake")
    return found | {"coast_brake_pct": curve and [list(point) for point in curve["points"]]}


def of_values(given: Mapping[str, Any]) -> CanPedals:
    """Pedals of what `values` gave; KeyError, TypeError or ValueError for others."""
    own = dict(given)
    own["power_mode"] = PowerMode[own["power_mode"].upper()]
    points = own.pop("coast_brake_pct", None)
    own["coast_brake"] = points and Curve(tuple((float(x), float(y)) for x, y in points))
    for name in ("throttle", "throttle_track2", "brake"):
        own[name] = own.get(name) and PedalTrack(**own[name])
    own["checksum"] = own.get("checksum") and PedalChecksum(**own["checksum"])
    return CanPedals(**own)
