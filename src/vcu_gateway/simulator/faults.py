"""Faults of the simulated vehicle by their parts, and the time that each lasts.

A transform changes a frame on its way to the bus, a change the vehicle itself, and a
foreign node sends frames of its own. `FaultInterval` says from when until when.
"""

import random
from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

from vcu_gateway.core.schedule import Schedule
from vcu_gateway.core.spec import SignalSpec
from vcu_gateway.simulator.nodes import NodeFrame, Transform
from vcu_gateway.simulator.vehicle import Vehicle
from vcu_gateway.units import NS_PER_S

NEVER_NS = 2**62
"""Later than anything happens."""

_BYTE_BITS = 8

Change = Callable[[Vehicle, bool], None]
"""Breaks the vehicle on True, repairs it on False."""

Report = Callable[[str], None]
"""Takes one sentence for the person at the terminal."""


def corrupted(flip_bits: int, seed: int) -> Transform:
    """The frame with this number of inverted bits, others in each frame."""
    chance = random.Random(seed)  # noqa: S311 - chance that can be repeated, no secret

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        bits = len(frame.data) * _BYTE_BITS
        flips = sum(1 << position for position in chance.sample(range(bits), min(flip_bits, bits)))
        return (frame._replace(data=_as_long(frame.data, _number(frame.data) ^ flips)),)

    return transform


def recoded(signal: SignalSpec, code_of: Callable[[int], int]) -> Transform:
    """The frame with one signal at another code, by the code that it has.

    What is wrong is the node's reading: a checksum is that of the other code, unless it is itself
    the signal.
    """
    read, written = _bits_of(signal)

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        code = code_of(read(frame.data))
        data = frame.seal(written(frame.data, code))
        return (frame._replace(data=written(data, code)),)

    return transform


def swapped(one: SignalSpec, other: SignalSpec) -> Transform:
    """The frame with the codes of two signals in each other's place."""
    (read_one, write_one), (read_other, write_other) = _bits_of(one), _bits_of(other)

    def transform(frame: NodeFrame) -> Iterable[NodeFrame]:
        data = write_one(frame.data, read_other(frame.data))
        data = write_other(data, read_one(frame.data))
        return (frame._replace(data=frame.seal(data)),)

    return transform


def _bits_of(
    signal: SignalSpec,
) -> tuple[Callable[[bytes], int], Callable[[bytes, int], bytes]]:
    """Functions that read a signal's code from a frame's data, and write it into them."""
    positions = tuple(enumerate(signal.bit_positions()))
    mask = sum(1 << bit for _, bit in positions)

    def read(data: bytes) -> int:
        number = _number(data)
        raw = sum((number >> bit & 1) << i for i, bit in positions)
        return raw - (1 << signal.length_bits) if raw > signal.raw_highest else raw

    def written(data: bytes, code: int) -> bytes:
        bits = sum((code >> i & 1) << bit for i, bit in positions)
        return _as_long(data, _number(data) & ~mask | bits)

    return read, written


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _as_long(data: bytes, number: int) -> bytes:
    """These bits, as far as a frame is long."""
    length = len(data)
    return (number & (1 << length * _BYTE_BITS) - 1).to_bytes(length, "little")


def only(messages: Collection[str], transform: Transform) -> Transform:
    """Transform of these messages alone."""
    return lambda frame: transform(frame) if frame.message in messages else (frame,)


def sometimes(share_pct: float, seed: int, transform: Transform) -> Transform:
    """Transform of a share of the frames, always the same ones for the same seed."""
    chance = random.Random(seed)  # noqa: S311 - chance that can be repeated, no secret
    return lambda frame: transform(frame) if chance.random() * 100 < share_pct else (frame,)


class ForeignNode(NamedTuple):
    """A node that sends this frame every period_ns."""

    can_id: int
    data: bytes
    message: str
    period_ns: int


class Fault(NamedTuple):
    """One fault by its parts; a part that is not given is healthy."""

    transform: Transform = lambda frame: (frame,)
    change: Change = lambda _vehicle, _broken: None
    foreign_node: ForeignNode | None = None


class FaultInterval:
    """A fault from begin_ns on until just before end_ns; None is without end."""

    def __init__(
        self, name: str, fault: Fault, begin_ns: int, end_ns: int | None, report: Report
    ) -> None:
        """`report` is called when it begins and when it ends."""
        self._name = name
        self._fault = fault
        self._changes = [(begin_ns, True), (NEVER_NS if end_ns is None else end_ns, False)]
        self._begin_ns, self._end_ns = begin_ns, self._changes[-1][0]
        self._report = report
        self._grid = fault.foreign_node and Schedule(begin_ns, fault.foreign_node.period_ns)

    def next_due_ns(self) -> int:
        """Time at which `due` has something to do; NEVER_NS once nothing is left."""
        changes_ns = self._changes[0][0] if self._changes else NEVER_NS
        if self._grid is None or self._grid.next_deadline_ns >= self._end_ns:
            return changes_ns
        return min(changes_ns, self._grid.next_deadline_ns)

    def due(self, vehicle: Vehicle, now_ns: int) -> Iterable[NodeFrame]:
        while self._changes and self._changes[0][0] <= now_ns:
            at_ns, broken = self._changes.pop(0)
            vehicle.advance(at_ns)
            self._fault.change(vehicle, broken)
            at_s = (at_ns - vehicle.start_ns) / NS_PER_S
            self._report(f"{at_s:.1f} s: {self._name} {'begins' if broken else 'ends'}")
        return self._foreign_frames(now_ns)

    def _foreign_frames(self, now_ns: int) -> Iterable[NodeFrame]:
        node, grid = self._fault.foreign_node, self._grid
        tick = grid.due(now_ns) if grid else None
        if node is None or tick is None or tick.deadline_ns >= self._end_ns:
            return ()
        return (NodeFrame(node.can_id, node.data, node.message, tick.deadline_ns),)

    def transform(self, frame: NodeFrame) -> Iterable[NodeFrame]:
        lasts = self._begin_ns <= frame.due_ns < self._end_ns
        return self._fault.transform(frame) if lasts else (frame,)
