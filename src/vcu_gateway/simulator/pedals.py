"""Pedal node: what a foot does, as the configured message of the vehicle's own DBC says it."""

from typing import Annotated, NamedTuple

from pydantic import AfterValidator, Field

from vcu_gateway.core.can_pedals import CanPedals, PedalTrack, checksum_of
from vcu_gateway.core.codec import MessageCodec
from vcu_gateway.core.curve import Curve
from vcu_gateway.strict_yaml.validation import Section, refusal

_RELEASED = Curve(((0.0, 0.0), (1.0, 0.0)))


class Foot(NamedTuple):
    """Travel of both pedals (%) over the time since the start (s)."""

    throttle_pct: Curve = _RELEASED
    brake_pct: Curve = _RELEASED


def _over_time(points: list[list[float]]) -> list[list[float]]:
    for index, point in enumerate(points):
        place = (index,)
        if len(point) != 2:
            raise refusal("must be [seconds, %]", "such as [4, 30]", place=place)
        if index and point[0] <= points[index - 1][0]:
            raise refusal("must be later than the point before", place=place)
        if point[0] < 0 or not 0 <= point[1] <= 100:
            raise refusal("must be a time from 0 on and 0 to 100 %", place=place)
    if len(points) < 2:
        raise refusal("must have two points or more", "such as [[4, 0], [5, 30]]")
    return points


_Travel = Annotated[list[list[float]], AfterValidator(_over_time)]


class FootSection(Section):
    """What the foot does: travel of a pedal over time, linear between the points."""

    throttle_pct: _Travel = Field(default=[[0, 0], [1, 0]], description="Seconds and %.")
    brake_pct: _Travel = Field(default=[[0, 0], [1, 0]], description="Seconds and %.")

    @property
    def foot(self) -> Foot:
        return Foot(_curve(self.throttle_pct), _curve(self.brake_pct))


def _curve(points: list[list[float]]) -> Curve:
    return Curve(tuple((at_s, travel_pct) for at_s, travel_pct in points))


class PedalNode:
    """Node that reads a foot and sends the pedals' message; the direction is forwards."""

    def __init__(self, pedals: CanPedals, codec: MessageCodec, foot: Foot) -> None:
        self.message = pedals.message
        self._pedals, self._spec, self._foot = pedals, codec.spec, foot

    def values(self, at_s: float, count: int) -> dict[str, float]:
        """Values of the next frame, this long after the start, by signal; `count` were before."""
        pedals, foot = self._pedals, self._foot
        tracks = (
            (pedals.throttle, foot.throttle_pct),
            (pedals.throttle_track2, foot.throttle_pct),
            (pedals.brake, foot.brake_pct),
        )
        values = {track.signal: _value(track, travel.at(at_s)) for track, travel in tracks if track}
        if pedals.counter is not None:
            counter = self._spec.signal(pedals.counter)
            codes = counter.raw_maximum - counter.raw_minimum + 1
            raw = counter.raw_minimum + count % codes
            values[pedals.counter] = raw * counter.factor + counter.offset
        return values

    def seal(self, data: bytes) -> bytes:
        """The frame with the checksum of its other bytes, where the message has one."""
        checksum = self._pedals.checksum
        if checksum is None:
            return data
        byte = self._spec.signal(checksum.signal).start_bit // 8
        own = checksum_of(data[:byte] + data[byte + 1 :], checksum.kind)
        return data[:byte] + bytes([own]) + data[byte + 1 :]


def _value(track: PedalTrack, travel_pct: float) -> float:
    return track.released + (track.pressed - track.released) * travel_pct / 100
