"""A recorded bus before the judge: every command frame, and the modes that the log tells.

    checked = check(recording.frames(), log=gateway.log())

A bus shows no demands and no ticks, so causes and demands are not judged here; what a command must
be by itself, beside the one before it and beside the motors' speeds is.
"""

import itertools
from datetime import datetime
from typing import Any, NamedTuple

from vcu_gateway.core.settings import Settings
from vcu_gateway.judge.command_rules import Judged, LimitRamps, SentBefore, TickFacts, broken
from vcu_gateway.judge.tuning_rules import TuningCaps
from vcu_gateway.judge.wire import COMMAND_IDS, MS, RECEIVED_IDS, command_bytes, speed_rpm
from vcu_gateway.replay.judged import limits_of

COMMANDS = tuple(COMMAND_IDS.values())
STATUS2 = tuple(can_id for can_id, name in RECEIVED_IDS.items() if name.endswith("_Status2"))
EXTENDED = 0b100
LIMITS = limits_of(Settings(), {})
# The gateway tells a mode after the frames of the same tick and before the next ones; of the last
# frames there are none.
TOLD_LATE_NS = 300 * MS
# Also because of that, the first frame of a CUT may stand before its FAULT.
NOT_ON_A_BUS = {"POWER_CUT in ACTIVE"}
_CONTROLLERS = {can_id: name for name, can_id in COMMAND_IDS.items()}
_SHOWN = 5


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


def check(frames, *, log=None, foreign=lambda frame: False) -> Checked:
    """Let every command frame of a recording be judged.

    `log`: the gateway's entries; without them no frame is asked whether torque was allowed.
    `foreign`: true of command frames that another sender put there.
    """
    bus = _Bus(None if log is None else modes_of(log))
    own = [frame for frame in frames if _is_command(frame) and not foreign(frame)]
    until_ns = iter(_followed_ns(own))
    for frame in frames:
        if frame.can_id in STATUS2 and frame.flags == EXTENDED and len(frame.data) == 8:
            bus.speeds[frame.can_id] = (frame.stamp_ns, speed_rpm(frame.data))
        if _is_command(frame) and not foreign(frame):
            bus.judge(frame, next(until_ns))
    assert not bus.wrong, "\n".join([f"{len(bus.wrong)} violations", *bus.wrong[:_SHOWN]])
    return _figures(own)


def is_safe(data: bytes) -> bool:
    """ZERO_TORQUE or POWER_CUT, in either direction."""
    command = command_bytes(data)
    at_most = command.speed_limit_rpm == LIMITS.speed_limit_max_rpm
    return command.safe and at_most and not command.unused


def modes_of(log) -> list[tuple[int, str]]:
    """Every change of mode with its wall-clock stamp, ns."""
    changes = [entry for entry in log if entry.get("event") == "mode_changed"]
    return [
        (int(datetime.fromisoformat(str(one["timestamp"])).timestamp() * 1e9), str(one["after"]))
        for one in changes
    ]


class _Bus:
    """What is known of a bus between two frames.

    Attributes:
        before: the last command of each identifier; last_tick: as it was before this tick.
        speeds: stamp and speed of each motor's last Status2.
    """

    def __init__(self, modes: list[tuple[int, str]] | None) -> None:
        self.modes = modes
        self.wrong: list[str] = []
        self.before: dict[int, Any] = {}
        self.last_tick: dict[int, Any] = {}
        self.speeds: dict[int, tuple[int, int]] = {}
        self._tick_ns = 0

    def judge(self, frame, until_ns: int) -> None:
        """Judge one command; the next one of its identifier came at `until_ns`."""
        if 2 * (frame.stamp_ns - self._tick_ns) >= LIMITS.period_ns or not self.before:
            self.last_tick, self._tick_ns = dict(self.before), frame.stamp_ns
        before = self.before.get(frame.can_id)
        told = f"{frame.stamp_ns} {frame.can_id:08X}#{frame.data.hex()}"
        if len(frame.data) != 8:
            self.wrong.append(f"eight bytes: {told}")
            return
        self.before[frame.can_id] = frame
        if before is not None and 2 * (frame.stamp_ns - before.stamp_ns) < LIMITS.period_ns:
            gap_ms = (frame.stamp_ns - before.stamp_ns) / MS
            self.wrong.append(f"I4 only {gap_ms:.2f} ms after the last: {told}")
        sent = None
        if before is not None:  # a stamp is not the tick's time: the slew gets a whole period
            sent = SentBefore(command_bytes(before.data), frame.stamp_ns - LIMITS.period_ns)
        judged = Judged(_CONTROLLERS[frame.can_id], command_bytes(frame.data), sent, None)
        for rule, seen in broken(judged, self._facts(frame.stamp_ns, until_ns)):
            if rule not in NOT_ON_A_BUS:
                self.wrong.append(f"{rule}: {seen}: {told}")

    def _facts(self, at_ns: int, until_ns: int) -> TickFacts:
        lasts = [command_bytes(frame.data) for frame in self.last_tick.values()]
        active = self.modes is None or _may_be_active(self.modes, at_ns, until_ns)
        return TickFacts(
            limits=LIMITS,
            mode="active" if active else "standby",
            effects=set(),
            caps=TuningCaps(),
            speeds_rpm=self._speeds_rpm(at_ns),
            regenerates=True,
            released=all(one.released for one in lasts),
            cut=False,
            holds=set(),
            ramps=LimitRamps(LIMITS),
            elapsed_ns=LIMITS.period_ns,
            now_ns=at_ns,
        )

    def _speeds_rpm(self, at_ns: int) -> list[int] | None:
        oldest_ns = at_ns - LIMITS.stale_ns["PCU1_Status2"] - TOLD_LATE_NS
        known = [self.speeds.get(can_id, (0, 0)) for can_id in STATUS2]
        if any(stamp_ns < oldest_ns for stamp_ns, _ in known):
            return None
        return [rpm for _, rpm in known]


def _is_command(frame) -> bool:
    return frame.can_id in COMMANDS and frame.flags == EXTENDED


def _followed_ns(own) -> list[int]:
    """Of each frame, when the next one of its identifier came."""
    found: list[int] = []
    after: dict[int, int] = {}
    for frame in reversed(own):
        found.append(after.get(frame.can_id, frame.stamp_ns + TOLD_LATE_NS))
        after[frame.can_id] = frame.stamp_ns
    return found[::-1]


def _may_be_active(modes: list[tuple[int, str]], at_ns: int, until_ns: int) -> bool:
    last = [mode for stamp_ns, mode in modes if stamp_ns <= at_ns]
    if last and last[-1] == "active":
        return True
    return "active" in [mode for stamp_ns, mode in modes if at_ns < stamp_ns <= until_ns]


def _figures(own) -> Checked:
    gaps_ms, missing = [], []
    for can_id in COMMANDS:
        stamps_ns = [frame.stamp_ns for frame in own if frame.can_id == can_id]
        gaps = [(b - a) / MS for a, b in itertools.pairwise(stamps_ns)]
        gaps_ms += gaps
        missing.append(sum(max(round(gap / LIMITS.period_ms) - 1, 0) for gap in gaps))
    return Checked(
        frames=len(own),
        with_torque=sum(frame.data[1] > 0 for frame in own),
        narrowest_ms=min(gaps_ms, default=0.0),
        widest_ms=max(gaps_ms, default=0.0),
        missing=max(missing),
    )
