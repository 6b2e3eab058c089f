"""What every frame must be, whatever the test does: I1 to I6 and I10 to I13 of the specification.

A model of its own over the recorded bytes. It knows the demands that were made and the requests to
arm, nothing of the gateway's inside.
"""

from collections import deque

from tests.oracle import wire
from tests.oracle.recorder import Frame

TICK_S = 0.050
GAP_S = 0.110
HALF_PERIOD_S = 0.025
JITTER_S = 0.002  # between the gateway's clock and the kernel's stamp
MODE_RANKS = (1, 2, 3, 0)  # by code: safety is the lowest
RELEASED = 12  # below 5 %
OUTDATED_S = 0.090  # from the answer to a demand to the last frame of the one before
STATUS = {
    wire.IDENTIFIERS["PCU1_Status2"]: wire.PCU1_COMMAND,
    wire.IDENTIFIERS["PCU2_Status2"]: wire.PCU2_COMMAND,
}


class Invariants:
    def __init__(self, limits: dict | None = None) -> None:
        limits = limits or {}
        self.speed_max = limits.get("speed_limit_max_rpm", 12000)
        self.power_max = limits.get("power_limit_max_w", 60000)
        self.throttle_step = limits.get("throttle_slew_pct_per_s", 100) * TICK_S / 0.39
        self.speed_step = limits.get("speed_slew_rpm_per_s", 4000) * TICK_S
        self.change_rpm = limits.get("direction_change_rpm", 50)
        self.regen_rpm = limits.get("regen_min_rpm", 100)
        self.power_step = limits.get("power_slew_w_per_s", 60000) * TICK_S
        self.independent = False  # directions
        self.violations: list[str] = []
        self.left_out: list[tuple[float, str]] = []  # frames that a busy machine may cost
        self.speeds: dict[int, tuple[float, int]] = {}
        self.demands: list[tuple[float, float, dict]] = []
        self.begin()

    def begin(self) -> None:
        """Another process, or another interface: nothing is known of the frame before."""
        self.before: dict[int, deque[Frame]] = {
            can_id: deque(maxlen=40) for can_id in wire.COMMANDS
        }
        self.latest: Frame | None = None
        self.may_drive = False
        self.excused_until = 0.0

    def frozen(self, t: float) -> None:
        """The test holds the process still until then: the gap is its own doing."""
        self.excused_until = t + 0.4

    def asked(self, before: float, after: float, values: dict) -> None:
        """A demand that was granted between two instants."""
        self.demands.append((before, after, values))

    def armed(self) -> None:
        self.may_drive = True

    def take(self, frame: Frame) -> None:
        if frame.can_id in STATUS:
            rpm = int.from_bytes(frame.data[6:8], "little")
            self.speeds[STATUS[frame.can_id]] = (frame.t, rpm)
        elif frame.can_id in wire.COMMANDS and frame.data[3] != wire.INTRUDER_MARK:
            self._command(frame)

    def _command(self, frame: Frame) -> None:
        if len(frame.data) != 8:
            self._broken(frame, "not 8 bytes")
            return
        before = self.before[frame.can_id]
        self._alone(frame)
        if before:
            self._after(frame, before[-1])
            self._rise(frame, before)
            self._mode_rise(frame, before[-1])
        self._pair(frame)
        self._torque(frame, before[-1] if before else None)
        before.append(frame)
        self.latest = frame

    def _alone(self, frame: Frame) -> None:
        c = frame.command
        if c.unused:
            self._broken(frame, "unused bits")
        if c.speed_limit > self.speed_max or c.speed_limit < min(500, self.speed_max):
            self._broken(frame, "I1 SpeedLimit")
        if c.power_limit > self.power_max:
            self._broken(frame, "I1 PowerLimit")
        if c.throttle > 64 and c.brake > 13:
            self._broken(frame, "I11 throttle and brake")
        if c.cut and (c.throttle or c.brake or c.regen or c.power_limit or c.power_mode != 3):
            self._broken(frame, "a cut with torque")
        if c.power_mode == 3 and c.throttle:
            self._broken(frame, "throttle with PowerMode safety")

    def _after(self, frame: Frame, before: Frame) -> None:
        gap = frame.t - before.t
        if gap > GAP_S and frame.t > self.excused_until:
            self.left_out.append((frame.t, f"I13 {gap * 1000:.0f} ms after the one before"))
        if gap < HALF_PERIOD_S - JITTER_S:
            self._broken(frame, f"I4 {gap * 1000:.1f} ms after the one before")
        now, then = frame.command, before.command
        if now.speed_limit < then.speed_limit - self.speed_step - 1:
            self._broken(frame, "I1 SpeedLimit falls too fast")
        if now.reverse != then.reverse and (now.throttle or then.throttle or self._turns(frame)):
            self._broken(frame, "I12 direction")

    def _rise(self, frame: Frame, history: "deque[Frame]") -> None:
        """Each frame earns one period of the slew at most, however late it is."""
        throttle = frame.command.throttle
        for back, earlier in enumerate(reversed(history), 1):
            if throttle - earlier.command.throttle > back * self.throttle_step + 1:
                self._broken(frame, f"I3 throttle rises over {back} frames")
                return

    def _mode_rise(self, frame: Frame, before: Frame) -> None:
        """PowerMode rises only where the last frame of each controller had released throttle."""
        if MODE_RANKS[frame.command.power_mode] <= MODE_RANKS[before.command.power_mode]:
            return
        for frames in self.before.values():
            earlier = [one for one in frames if frame.t - one.t > 0.020]  # not of this tick
            if earlier and earlier[-1].command.throttle > RELEASED:
                self._broken(frame, "PowerMode rises with throttle")
                return

    def _turns(self, frame: Frame) -> bool:
        """Whether a motor is unknown or too fast, by the last Status2 of each."""
        for can_id in wire.COMMANDS:
            t, rpm = self.speeds.get(can_id, (0.0, 65535))
            if frame.t - t > 0.250 or rpm >= self.change_rpm:
                return True
        return False

    def _pair(self, frame: Frame) -> None:
        if self.latest is None:
            return
        if self.latest.can_id == frame.can_id:
            if frame.t > self.excused_until:
                self.left_out.append((frame.t, "I13 one controller was left out"))
        elif frame.t - self.latest.t < 0.020:
            pair = (self.latest.command, frame.command)
            if pair[0].reverse != pair[1].reverse and not self.independent:
                self._broken(frame, "opposite directions")
            if self._is_safe(self.latest) != self._is_safe(frame):
                self._broken(frame, "I13 a safe frame for one controller alone")

    @staticmethod
    def _is_safe(frame: Frame) -> bool:
        c = frame.command
        return c.power_mode == 3 and not (c.throttle or c.brake or c.regen or c.power_limit)

    def _torque(self, frame: Frame, before: Frame | None) -> None:
        """I2, I6: after a safe frame only a request to arm lets torque come back."""
        if self._is_safe(frame):
            return
        if before is None or self._is_safe(before):
            other = self.latest
            began = other is not None and not self._is_safe(other)
            if not began:
                if not self.may_drive:
                    self._broken(frame, "I2 torque without a request to arm")
                self.may_drive = False
        self._as_asked(frame)

    def _as_asked(self, frame: Frame) -> None:
        """I1: never more than one of the demands that could count when it was computed."""
        counted = [
            values
            for index, (sent, _, values) in enumerate(self.demands)
            if sent <= frame.t
            and (
                index + 1 == len(self.demands) or frame.t < self.demands[index + 1][1] + OUTDATED_S
            )
        ]
        which = "PCU1" if frame.can_id == wire.PCU1_COMMAND else "PCU2"
        asked = [values.get("controllers", {}).get(which, values) for values in counted]
        c = frame.command
        most = max((wire.percent(one.get("throttle_pct", 0)) for one in asked), default=0)
        if c.throttle > most:
            self._broken(frame, f"I1 throttle {c.throttle}, asked {most}")
        most = max((wire.percent(one.get("brake_pct", 0)) for one in asked), default=0)
        if c.brake > most:
            self._broken(frame, f"I1 brake {c.brake}, asked {most}")
        if c.regen and not any(one.get("regen_brake") for one in asked):
            self._broken(frame, "I10 regeneration that nobody asked for")

    def _broken(self, frame: Frame, what: str) -> None:
        if len(self.violations) < 20:
            self.violations.append(f"{frame.t:.4f} {frame.can_id:08X}#{frame.data.hex()} {what}")
