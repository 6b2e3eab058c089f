"""The invariants (docs/safety.md) on a recorded bus, from the frames and the mode that is told.

    checked = check(recording.frames(), log=gateway.log())

Nothing of the program under test is used here.
"""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, NamedTuple, Protocol, TypeVar

MS = 1_000_000
COMMANDS = (0x0008A7D0, 0x0008A8D0)
STATUS2 = (0x0809D0A7, 0x0809D0A8)
EXTENDED = 0b100
STALE_NS = 200 * MS
# The gateway tells a mode after the frames of the same tick and before the next ones; of the last
# frames there are none.
TOLD_LATE_NS = 300 * MS
PERCENT_PER_BIT = 0.39
_SHOWN = 5


class Recorded(Protocol):
    """A frame as a recorder saw it: stamp of the kernel, flags (4: extended)."""

    @property
    def stamp_ns(self) -> int: ...
    @property
    def flags(self) -> int: ...
    @property
    def can_id(self) -> int: ...
    @property
    def data(self) -> bytes: ...


AnyRecorded = TypeVar("AnyRecorded", bound=Recorded)


@dataclass(frozen=True)
class Limits:
    """What the configuration says."""

    period_ms: float = 50.0
    slew_pct_per_s: float = 100.0
    speed_max_rpm: int = 12_000
    power_max_w: int = 60_000
    direction_change_rpm: float = 50.0


class Checked(NamedTuple):
    """What was seen of the command frames of both controllers.

    Attributes:
        missing: points of the 50 ms grid without a frame, of the controller that missed more.
    """

    frames: int
    with_torque: int
    narrowest_ms: float
    widest_ms: float
    missing: int

    def __str__(self) -> str:
        return (
            f"{self.frames} command frames {self.narrowest_ms:.1f} to {self.widest_ms:.1f} ms apart"
        )


@dataclass
class _Bus:
    limits: Limits
    modes: list[tuple[int, str]] | None
    wrong: list[str] = field(default_factory=list)
    before: dict[int, Recorded] = field(default_factory=dict)
    speeds: dict[int, tuple[int, int]] = field(default_factory=dict)

    def must(self, holds: bool, sentence: str, frame: Recorded) -> None:
        if not holds:
            told = f"{frame.stamp_ns} {frame.can_id:08X}#{frame.data.hex()}"
            self.wrong.append(f"{sentence}: {told}")


def check(
    frames: Sequence[AnyRecorded],
    *,
    log: Iterable[Mapping[str, Any]] | None = None,
    foreign: Callable[[AnyRecorded], bool] = lambda frame: False,
    limits: Limits | None = None,
) -> Checked:
    """Hold every command frame of a recording against the invariants.

    `log`: the gateway's entries; without them no frame is asked whether torque was allowed.
    `foreign`: true of command frames that another sender put there.
    """
    bus = _Bus(limits or Limits(), None if log is None else modes_of(log))
    own = [frame for frame in frames if _is_command(frame) and not foreign(frame)]
    until_ns = iter(_followed_ns(own))
    for frame in frames:
        if frame.can_id in STATUS2 and frame.flags == EXTENDED and len(frame.data) == 8:
            speed_rpm = int.from_bytes(frame.data[6:8], "little")
            bus.speeds[frame.can_id] = (frame.stamp_ns, speed_rpm)
        if _is_command(frame) and not foreign(frame):
            _check_shape(bus, frame, next(until_ns))
            _check_step(bus, frame)
            bus.before[frame.can_id] = frame
    assert not bus.wrong, "\n".join([f"{len(bus.wrong)} violations", *bus.wrong[:_SHOWN]])
    return _figures(own, bus.limits)


def _is_command(frame: Recorded) -> bool:
    return frame.can_id in COMMANDS and frame.flags == EXTENDED


def _followed_ns(own: Sequence[Recorded]) -> list[int]:
    """Of each frame, when the next one of its identifier came."""
    found: list[int] = []
    after: dict[int, int] = {}
    for frame in reversed(own):
        found.append(after.get(frame.can_id, frame.stamp_ns + TOLD_LATE_NS))
        after[frame.can_id] = frame.stamp_ns
    return found[::-1]


def modes_of(log: Iterable[Mapping[str, Any]]) -> list[tuple[int, str]]:
    """Every change of mode with its wall-clock stamp, ns."""
    changes = [entry for entry in log if entry.get("event") == "mode_changed"]
    return [
        (int(datetime.fromisoformat(str(one["timestamp"])).timestamp() * 1e9), str(one["after"]))
        for one in changes
    ]


def is_safe(data: bytes, speed_max_rpm: int = 12_000) -> bool:
    """ZERO_TORQUE or POWER_CUT, in either direction."""
    zero = data[1] == data[2] == data[3] == data[6] == data[7] == 0
    return zero and data[0] & ~0x90 == 0x0C and int.from_bytes(data[4:6], "little") == speed_max_rpm


def _check_shape(bus: _Bus, frame: Recorded, until_ns: int) -> None:
    """What one frame shows by itself; the next one came at `until_ns`."""
    data, limits = frame.data, bus.limits
    bus.must(len(data) == 8, "eight bytes", frame)
    if len(data) != 8:
        return
    bus.must(not data[3] and not data[0] & 0x43, "unused bits are 0", frame)
    bus.must(int.from_bytes(data[4:6], "little") <= limits.speed_max_rpm, "I1 speed", frame)
    bus.must(int.from_bytes(data[6:8], "little") <= limits.power_max_w, "I1 power", frame)
    both = data[1] * PERCENT_PER_BIT > 25.2 and data[2] * PERCENT_PER_BIT > 5.2
    bus.must(not both, "I11 throttle and brake", frame)
    if bus.modes is not None and not _may_be_active(bus.modes, frame.stamp_ns, until_ns):
        bus.must(is_safe(data, limits.speed_max_rpm), "I2 torque outside ACTIVE", frame)


def _may_be_active(modes: list[tuple[int, str]], at_ns: int, until_ns: int) -> bool:
    last = [mode for stamp_ns, mode in modes if stamp_ns <= at_ns]
    if last and last[-1] == "active":
        return True
    soon = [mode for stamp_ns, mode in modes if at_ns < stamp_ns <= until_ns]
    return "active" in soon


def _check_step(bus: _Bus, frame: Recorded) -> None:
    """What a frame shows beside the one before it."""
    before = bus.before.get(frame.can_id)
    if before is None or len(frame.data) != 8 or len(before.data) != 8:
        return
    limits = bus.limits
    gap_ms = (frame.stamp_ns - before.stamp_ns) / MS
    bus.must(gap_ms >= limits.period_ms / 2, f"I4 only {gap_ms:.2f} ms after the last", frame)
    earned_pct = limits.slew_pct_per_s * limits.period_ms / 1000
    highest = before.data[1] + earned_pct / PERCENT_PER_BIT + 1
    bus.must(frame.data[1] <= highest, f"I3 rise from {before.data[1]}", frame)
    if (frame.data[0] ^ before.data[0]) & 0x10:
        still = frame.data[1] == before.data[1] == 0
        bus.must(still and _slow(bus, frame.stamp_ns), "I12 direction", frame)


def _slow(bus: _Bus, at_ns: int) -> bool:
    known = [bus.speeds.get(can_id) for can_id in STATUS2]
    return all(
        one is not None
        and at_ns - one[0] <= STALE_NS + TOLD_LATE_NS
        and one[1] < bus.limits.direction_change_rpm
        for one in known
    )


def _figures(own: Sequence[Recorded], limits: Limits) -> Checked:
    gaps_ms, missing = [], []
    for can_id in COMMANDS:
        stamps_ns = [frame.stamp_ns for frame in own if frame.can_id == can_id]
        gaps = [(b - a) / MS for a, b in itertools.pairwise(stamps_ns)]
        gaps_ms += gaps
        missing.append(sum(max(round(gap / limits.period_ms) - 1, 0) for gap in gaps))
    return Checked(
        frames=len(own),
        with_torque=sum(frame.data[1] > 0 for frame in own),
        narrowest_ms=min(gaps_ms, default=0.0),
        widest_ms=max(gaps_ms, default=0.0),
        missing=max(missing),
    )
