"""What can break in the simulated vehicle: each fault is one small function.

A transform changes a frame on its way to the bus, a change the vehicle itself, and an
intruder sends by itself. `FaultInterval` says from when until when.
"""

import random
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from vcu_gateway.core.schedule import Schedule
from vcu_gateway.core.spec import SignalSpec
from vcu_gateway.simulator.nodes import NodeFrame, Transform
from vcu_gateway.simulator.vehicle import Vehicle
from vcu_gateway.units import NS_PER_MS

NEVER_NS = 2**62
"""Later than anything happens."""

_BYTE_BITS = 8
_ALL_PCT = 100.0

Change = Callable[[Vehicle, bool], None]
"""Breaks the vehicle where it is told True, mends it where it is told False."""

Report = Callable[[str], None]
"""Takes one sentence for the person who watches."""


# What may happen to a frame.


def whole(frame: NodeFrame) -> Iterable[NodeFrame]:
    """Nothing happens to it."""
    return (frame,)


def lost(frame: NodeFrame) -> Iterable[NodeFrame]:
    """It never leaves."""
    del frame
    return ()


def doubled(frame: NodeFrame) -> Iterable[NodeFrame]:
    """It leaves twice."""
    return (frame, frame)


def delayed(delay_ms: int) -> Transform:
    """It leaves so much later."""

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        return (frame._replace(due_ns=frame.due_ns + delay_ms * NS_PER_MS),)

    return transform


def shortened(length_bytes: int) -> Transform:
    """It carries so many bytes only."""

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        return (frame._replace(data=frame.data[:length_bytes]),)

    return transform


def corrupted(flip_bits: int, seed: int) -> Transform:
    """So many of its bits are wrong, others in each frame."""
    dice = _dice(seed)

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        bits = len(frame.data) * _BYTE_BITS
        flips = sum(1 << position for position in dice.sample(range(bits), min(flip_bits, bits)))
        return (frame._replace(data=_bytes(_number(frame.data) ^ flips, len(frame.data))),)

    return transform


def overridden(signal: SignalSpec, raw: int) -> Transform:
    """One signal says this code."""
    mask = _placed(signal, -1)
    bits = _placed(signal, raw)

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        return (_with_bits(frame, mask, bits),)

    return transform


def frozen(signal: SignalSpec) -> Transform:
    """One signal keeps the code of the first frame that comes here."""
    mask = _placed(signal, -1)
    kept: list[int] = []

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        if not kept:
            kept.append(_number(frame.data) & mask)
        return (_with_bits(frame, mask, kept[0]),)

    return transform


def shifted(signal: SignalSpec, by: int) -> Transform:
    """One signal says so many codes more, and its last code beyond that."""
    mask = _placed(signal, -1)

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        raw = max(signal.raw_lowest, min(signal.raw_highest, _raw(signal, frame) + by))
        return (_with_bits(frame, mask, _placed(signal, raw)),)

    return transform


def negated(signal: SignalSpec) -> Transform:
    """One signal says its code below 0, in two's complement."""
    mask = _placed(signal, -1)

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        return (_with_bits(frame, mask, _placed(signal, -_raw(signal, frame))),)

    return transform


# To which frames.


def only(messages: Collection[str], transform: Transform) -> Transform:
    """Do this to these messages and nothing to the others."""
    return lambda frame: transform(frame) if frame.message in messages else (frame,)


def sometimes(share_pct: float, seed: int, transform: Transform) -> Transform:
    """Do this to a share of the frames, always the same ones for the same seed."""
    if share_pct >= _ALL_PCT:
        return transform
    dice = _dice(seed)
    return lambda frame: transform(frame) if dice.random() * _ALL_PCT < share_pct else (frame,)


def _dice(seed: int) -> random.Random:
    return random.Random(seed)  # noqa: S311 - chance that can be repeated, no secret


# What may happen to the controllers.


def untouched(vehicle: Vehicle, broken: bool) -> None:
    """Nothing happens to the vehicle."""


def ignoring(controllers: Sequence[str], throttle_pct: float | None) -> Change:
    """These controllers go on with what they obey now, or with another throttle of it."""

    def change(vehicle: Vehicle, broken: bool) -> None:
        for name in controllers:
            motor = vehicle.motors[name]
            motor.ignores_commands = broken
            if broken and throttle_pct is not None:
                motor.order = motor.order._replace(throttle_pct=throttle_pct)

    return change


def turned_round(controllers: Sequence[str]) -> Change:
    """These controllers take forwards for reverse and reverse for forwards."""

    def change(vehicle: Vehicle, broken: bool) -> None:
        for name in controllers:
            vehicle.motors[name].turned_round = broken

    return change


# Put together.


class ForeignNode(NamedTuple):
    """A node that sends this frame every period_ns."""

    can_id: int
    data: bytes
    message: str
    period_ns: int


@dataclass(frozen=True, slots=True)
class Fault:
    """What is broken; a part that is not given is whole."""

    transform: Transform = whole
    change: Change = untouched
    intruder: ForeignNode | None = None


class FaultInterval:
    """A fault from begin_ns on until just before end_ns; None is for ever."""

    def __init__(
        self, name: str, fault: Fault, begin_ns: int, end_ns: int | None, tell: Report
    ) -> None:
        """`tell` hears when it begins and when it ends."""
        self._name = name
        self._fault = fault
        self._changes = [(begin_ns, True), (NEVER_NS if end_ns is None else end_ns, False)]
        self._begin_ns, self._end_ns = begin_ns, self._changes[-1][0]
        self._tell = tell
        self._grid = fault.intruder and Schedule(begin_ns, fault.intruder.period_ns)

    def next_due_ns(self) -> int:
        """When `due` has something to do; NEVER_NS once nothing is left."""
        changes_ns = self._changes[0][0] if self._changes else NEVER_NS
        if self._grid is None or self._grid.next_deadline_ns >= self._end_ns:
            return changes_ns
        return min(changes_ns, self._grid.next_deadline_ns)

    def due(self, vehicle: Vehicle, now_ns: int) -> Iterable[NodeFrame]:
        """Break or mend the vehicle where it is time to; what an intruder sends now."""
        while self._changes and self._changes[0][0] <= now_ns:
            at_ns, broken = self._changes.pop(0)
            vehicle.advance(at_ns)
            self._fault.change(vehicle, broken)
            at_s = (at_ns - vehicle.start_ns) / 1e9
            self._tell(f"{at_s:.1f} s: {self._name} {'begins' if broken else 'ends'}")
        return self._intrusion(now_ns)

    def _intrusion(self, now_ns: int) -> Iterable[NodeFrame]:
        intruder, grid = self._fault.intruder, self._grid
        tick = grid.due(now_ns) if grid else None
        if intruder is None or tick is None or tick.deadline_ns >= self._end_ns:
            return ()
        return (NodeFrame(intruder.can_id, intruder.data, intruder.message, tick.deadline_ns),)

    def transform(self, frame: NodeFrame) -> Iterable[NodeFrame]:
        """What becomes of a frame that is due while this lasts."""
        lasts = self._begin_ns <= frame.due_ns < self._end_ns
        return self._fault.transform(frame) if lasts else (frame,)


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _bytes(number: int, length: int) -> bytes:
    """The lowest `length` bytes of a number."""
    return (number & (1 << length * _BYTE_BITS) - 1).to_bytes(length, "little")


def _placed(signal: SignalSpec, raw: int) -> int:
    """The bits of a code where the signal has them in the frame; -1 is all of them."""
    return sum((raw >> i & 1) << bit for i, bit in enumerate(signal.bit_positions()))


def _raw(signal: SignalSpec, frame: NodeFrame) -> int:
    """The code of a signal in this frame."""
    number = _number(frame.data)
    bits = enumerate(signal.bit_positions())
    raw = sum((number >> bit & 1) << i for i, bit in bits)
    return raw - (1 << signal.length_bits) if raw > signal.raw_highest else raw


def _with_bits(frame: NodeFrame, mask: int, bits: int) -> NodeFrame:
    number = _number(frame.data) & ~mask | bits
    return frame._replace(data=_bytes(number, len(frame.data)))
