"""Records of a drive: what the core was given, what it answered, and what is missing."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from vcu_gateway.core.causes import Event
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.gateway import CoreCall
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.transmit import OutFrame


class Checkpoint(NamedTuple):
    """State of the core with which a segment begins.

    Attributes:
        state: for `checkpoint.restore`.
        settings: those in effect.
        mode, why: operating mode and its explanation then.
        now_ns, wall_ns: both clocks, read together.
        ticks, frames: since the start of the gateway.
    """

    state: Mapping[str, Any]
    settings: Settings
    mode: Mode
    why: str
    now_ns: int
    wall_ns: int
    ticks: int
    frames: int


class InputRecord(NamedTuple):
    """A call other than a tick; `answer` is None where it has none."""

    input: CoreCall[object]
    answer: RequestResult | None


class FrameRun(NamedTuple):
    """Frames that came one after the other, without another call between them."""

    frames: list[Frame]


class TickRecord(NamedTuple):
    """A tick and its result; how the bus took the frames follows as `NoteSent`."""

    now_ns: int
    frames: tuple[OutFrame, ...]
    mode: Mode
    events: tuple[Event, ...]


class WhyRecord(NamedTuple):
    """Sentence of `Gateway.why(now_ns)`, asked at this place; kept where it says something new."""

    now_ns: int
    sentence: str


class ShellEvent(NamedTuple):
    """Event that the core does not know of: the shell's, around it."""

    now_ns: int
    event: Event


class Gap(NamedTuple):
    """What is missing at this place: a checkpoint follows, with a state from behind it.

    Attributes:
        frames, ticks, datagrams: how many are missing; None where that is not known.
        why: in words.
    """

    frames: int | None
    ticks: int | None
    datagrams: int | None
    why: str


CoreRecord = Checkpoint | InputRecord | TickRecord | WhyRecord | ShellEvent | Gap
"""What one core line says, in the order in which it happened."""
