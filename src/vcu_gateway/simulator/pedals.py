"""Pedal node: what a foot does, as the configured message of the vehicle's own DBC says it."""

from typing import NamedTuple

from vcu_gateway.core.can_pedals import CanPedals, PedalTrack, checksum_of
from vcu_gateway.core.codec import MessageCodec
from vcu_gateway.core.curve import Curve

_RELEASED = Curve(((0.0, 0.0), (1.0, 0.0)))


class Foot(NamedTuple):
    """Travel of both pedals (%) over the time since the start (s)."""

    throttle_pct: Curve = _RELEASED
    brake_pct: Curve = _RELEASED


class PedalNode:
    """Node that reads a foot and sends the pedals' message; the direction is forwards."""

    def __init__(self, pedals: CanPedals, codec: MessageCodec, foot: Foot) -> None:
        self.message = pedals.message
        self._pedals, self._spec, self._foot = pedals, codec.spec, foot

    def values(self, at_s: float, count: int) -> dict[str, float]:
        """Values of the next frame, this long after the start, by signal; `count` were before."""
        pedals, foot = self._pedals, self._foot
        travel_pct = foot.throttle_pct.at(at_s)
        values = {
            track.signal: _value(track, travel_pct)
            for track in (pedals.throttle, pedals.throttle_track2)
            if track is not None
        }
        if pedals.brake is not None:
            values[pedals.brake.signal] = _value(pedals.brake, foot.brake_pct.at(at_s))
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
