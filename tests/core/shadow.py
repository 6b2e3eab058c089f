"""SAFETY.md a second time, from the bytes of the frames alone: what the gateway is held against.

Nothing of the core's decisions is used here: no codec, no rules, no modes but their names.
"""

from collections import Counter
from dataclasses import dataclass, field

MS = 1_000_000
PERCENT_PER_BIT = 0.39
SLOTS = ("PCU1", "PCU2")
COMMAND_IDS = {0x0008A7D0: "PCU1", 0x0008A8D0: "PCU2"}
RECEIVED_IDS = {
    0x040AD092: "ARD2_SteeringWheel",
    0x1808D0F4: "BMS_Status",
    0x1809D0F4: "BMS_Temperatures",
    0x040AD079: "IMU_Acceleration",
    0x040BD079: "IMU_AngularRate",
    0x040CD079: "IMU_Attitude",
    0x08F02DE2: "IMU_Attitude",
    0x0808D0A7: "PCU1_Status1",
    0x0809D0A7: "PCU1_Status2",
    0x0808D0A8: "PCU2_Status1",
    0x0809D0A8: "PCU2_Status2",
}
ID_OF = {name: can_id for can_id, name in RECEIVED_IDS.items() if can_id != 0x08F02DE2}
_MATCH = 0x03FF_FFFF
_BY_KEY = {can_id & _MATCH: name for can_id, name in RECEIVED_IDS.items()}
_COMMAND_BY_KEY = {can_id & _MATCH: name for can_id, name in COMMAND_IDS.items()}
_GROUPS = {key >> 8 for key in (*_BY_KEY, *_COMMAND_BY_KEY)}

STALE_AFTER_MS = {"BMS_Status": 1600, "PCU1_Status2": 200, "PCU2_Status2": 200,
                  "PCU1_Status1": 1600, "PCU2_Status1": 1600}  # fmt: skip
LATE_AFTER_MS = 1100
FUTURE_MS = 20


@dataclass
class Seen:
    """A cause with an effect: at which tick it was last seen."""

    at_ns: int
    until_restart: bool = False


@dataclass
class Shadow:
    """What a second reader of the bus knows."""

    settings: object
    received: dict = field(default_factory=dict)
    rejected: Counter = field(default_factory=Counter)
    taken: Counter = field(default_factory=Counter)
    life_repeats: int = 0
    sent: dict = field(default_factory=dict)
    history: dict = field(default_factory=lambda: {slot: [] for slot in SLOTS})
    held: dict = field(default_factory=dict)
    power_w: dict = field(default_factory=dict)
    brake_pct: dict = field(default_factory=dict)
    override: bool = False
    foreign: bool = False
    silent_ticks: dict = field(default_factory=lambda: dict.fromkeys(SLOTS, 0))
    echoed: set = field(default_factory=set)

    def __post_init__(self):
        self.power_w = dict.fromkeys(SLOTS, self.settings.power_limit_max_w)
        self.brake_pct = dict.fromkeys(SLOTS, 100.0)

    # Frames in.

    def receive(self, frame):
        """Sort one frame; the name of the kind it was counted as."""
        kind = self._kind(frame)
        command = _COMMAND_BY_KEY.get(frame.can_id & _MATCH)
        if kind in ("remote", "short", "long") and frame.extended and command:
            self._command(frame, command, confirms=False)
        if kind is not None:
            self.rejected[kind] += 1
            return kind
        if command:
            self._command(frame, command, confirms=True)
            return "command"
        return self._message(_BY_KEY[frame.can_id & _MATCH], frame)

    def _kind(self, frame):
        if frame.error or frame.remote:
            return "error" if frame.error else "remote"
        if not frame.extended:
            return "standard_id"
        key = frame.can_id & _MATCH
        if key not in _BY_KEY and key not in _COMMAND_BY_KEY:
            return "foreign_source" if key >> 8 in _GROUPS else "unknown"
        if len(frame.data) != 8:
            return "short" if len(frame.data) < 8 else "long"
        return None

    def _command(self, frame, slot, *, confirms):
        if not frame.own_echo:
            self.taken["foreign"] += 1
            self.foreign = True
        elif confirms:
            self.taken["confirmed"] += 1
            self.echoed.add(slot)

    def _message(self, name, frame):
        before = self.received.get(name)
        if before is not None and frame.arrival_ns < before[1]:
            self.taken["out_of_order"] += 1
            return "out_of_order"
        self.taken["stored"] += 1
        if name == "BMS_Status" and before is not None:
            same = (before[0][7] ^ frame.data[7]) & 0x80 == 0
            self.life_repeats = self.life_repeats + 1 if same else 0
        self.received[name] = (bytes(frame.data), frame.arrival_ns)
        return "stored"

    # What is known at an instant.

    def age_ms(self, name, now_ns):
        """None where it never came or comes from the future."""
        if name not in self.received:
            return None
        age_ms = (now_ns - self.received[name][1]) / MS
        return None if age_ms < -FUTURE_MS else age_ms

    def stale(self, name, now_ns):
        age_ms = self.age_ms(name, now_ns)
        return age_ms is None or age_ms > STALE_AFTER_MS[name]

    def slow(self, now_ns):
        """Both speeds known, fresh, in range and below the change speed."""
        for slot in SLOTS:
            name = f"{slot}_Status2"
            if self.stale(name, now_ns):
                return False
            speed_rpm = int.from_bytes(self.received[name][0][6:8], "little")
            if speed_rpm > 6000 or speed_rpm >= self.settings.direction_change_rpm:
                return False
        return True

    def _battery(self, byte, shift, bits=3):
        data = self.received.get("BMS_Status", (bytes(8),))[0]
        return data[byte - 1] >> shift & bits

    def causes(self, now_ns, tick_late_ns, link_down):
        """Names of the causes of this instant, by effect; the worst ones stop or cut."""
        found = {effect: set() for effect in
                 ("turbo_off", "power", "regen", "regen_off", "stop", "cut")}  # fmt: skip
        self._battery_causes(found)
        self._age_causes(found, now_ns)
        for slot in SLOTS:
            self._controller_causes(found, slot, now_ns)
        stops = {
            "tick late": tick_late_ns > 4 * self.settings.period_ns,
            "link": link_down,
            "unconfirmed": self.settings.expect_echo and max(self.silent_ticks.values()) >= 3,
            "foreign": self.foreign,
        }
        found["stop"] |= {name for name, stands in stops.items() if stands}
        return found

    def _battery_causes(self, found):
        over, under, current = (self._battery(6, shift) for shift in (0, 2, 6))
        hot, cold, internal = self._battery(7, 2), self._battery(7, 4), self._battery(7, 7, 1)
        table = {
            "regen": {"over 1": over == 1, "current 1": current == 1},
            "regen_off": {"over": over >= 2, "cold 1": cold == 1},
            "power": {"under 1": under == 1, "current 1": current == 1},
            "stop": {"under 2": under == 2},
            "cut": {"under 3": under == 3, "current": current >= 2, "hot": hot >= 2,
                    "cold": cold >= 2, "internal": internal == 1},
        }  # fmt: skip
        for effect, causes in table.items():
            found[effect] |= {name for name, stands in causes.items() if stands}
        if over == 3:
            found["regen_off"].add("over 3")

    def _age_causes(self, found, now_ns):
        age_ms = self.age_ms("BMS_Status", now_ns)
        if age_ms is not None and age_ms > LATE_AFTER_MS:
            found["regen"].add("late")
            found["power"].add("late")
        if self.life_repeats >= 1:
            found["regen"].add("life")
            found["power"].add("life")
        if self.life_repeats >= 2:
            found["stop"].add("life")
        for name in ("BMS_Status", "PCU1_Status2", "PCU2_Status2"):
            if self.stale(name, now_ns):
                found["stop"].add(name)

    def _controller_causes(self, found, slot, now_ns):
        name = f"{slot}_Status1"
        if self.stale(name, now_ns):
            found["turbo_off"].add(name)
            found["power"].add(name)
        if name not in self.received:
            return
        data, arrival_ns = self.received[name]
        level, heat = data[3] & 7, data[3] >> 5 & 3
        if level in (0, 1, 6, 7):
            found["power"].add(f"{slot} voltage")
        if level in (0, 5, 6, 7):
            found["regen_off"].add(f"{slot} voltage")
        if heat == 1:
            found["turbo_off"].add(f"{slot} heat")
        if heat >= 2:
            found["stop"].add(f"{slot} heat")
        told = max(
            (raw for at_ns, raw in self.history[slot] if 0 <= arrival_ns - at_ns <= 1000 * MS),
            default=0,
        )
        excess_pct = (data[1] - told) * PERCENT_PER_BIT - 5.0
        if not self.stale(name, now_ns) and excess_pct > 1e-6:
            found["stop"].add(f"{slot} echo")

    def hold(self, found, now_ns):
        """Effects that count now: seen now, or gone for less than the holding time."""
        for effect, names in found.items():
            for name in names:
                self.held[effect, name] = Seen(now_ns, name == "over 3")
        hold_ns = self.settings.clear_hold_ms * MS
        for key, seen in list(self.held.items()):
            if not seen.until_restart and 0 < now_ns - seen.at_ns >= hold_ns:
                del self.held[key]
        return {effect for effect, _ in self.held}

    # Limits on their way.

    def move_limits(self, effects, elapsed_ns):
        """The highest power and brake that may be commanded now."""
        settings = self.settings
        elapsed_s = min(max(elapsed_ns, 0), settings.period_ns) / 1e9
        for slot in SLOTS:
            data = self.sent[slot][0] if slot in self.sent else bytes(8)
            told_w = int.from_bytes(data[6:8], "little")
            # The highest code stands for everything up to 100 % (PROTOCOL.md E10).
            told_pct = 100.0 if data[2] == 255 else data[2] * PERCENT_PER_BIT
            target_w = target_pct = None
            if "power" in effects:
                target_w = min(settings.derated_power_w, settings.power_limit_max_w)
            if "regen" in effects:
                target_pct = settings.regen_limit_pct
            self.power_w[slot] = _moved(
                self.power_w[slot], told_w, target_w, settings.power_limit_max_w,
                settings.power_slew_w_per_s * elapsed_s,
            )  # fmt: skip
            self.brake_pct[slot] = _moved(
                self.brake_pct[slot], told_pct, target_pct, 100.0,
                settings.regen_slew_pct_per_s * elapsed_s,
            )  # fmt: skip
            if "regen_off" in effects:
                self.brake_pct[slot] = 0.0

    def note_override(self, asked):
        if any(one.throttle_pct > 25 and one.brake_pct > 5 for one in asked.values()):
            self.override = True
        elif all(one.throttle_pct < 5 for one in asked.values()):
            self.override = False

    # Frames out.

    def note_sent(self, slot, data, now_ns):
        self.sent[slot] = (data, now_ns)
        history = self.history[slot]
        history.append((now_ns, data[1]))
        while now_ns - history[0][0] > 4000 * MS:
            history.pop(0)

    def throttle_max_raw(self, slot, now_ns):
        """Last one sent, plus the slew, plus half a bit of rounding now and half a bit then."""
        if slot not in self.sent:
            return 0
        data, at_ns = self.sent[slot]
        elapsed_s = min(max(now_ns - at_ns, 0), self.settings.period_ns) / 1e9
        earned_pct = self.settings.throttle_slew_pct_per_s * elapsed_s
        return data[1] + earned_pct / PERCENT_PER_BIT + 1


def _moved(limit, told, target, highest, step):
    if target is None or target >= limit:
        return min(highest if target is None else target, limit + step)
    return max(target, min(limit, told) - step)


def is_safe(data, speed_limit_max_rpm):
    """ZERO_TORQUE or POWER_CUT: nothing but safety mode, direction, cut and the speed limit."""
    speed_rpm = data[4] | data[5] << 8
    zero = data[1] == data[2] == data[3] == data[6] == data[7] == 0
    return zero and data[0] & ~0x90 == 0x0C and speed_rpm == speed_limit_max_rpm
