"""Reference model: docs/safety.md once more, from the bytes of frames alone.

Nothing of the core's decisions is used here: no codec, no rules, no modes but their names.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

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
# Pages 0 and PF 8, then whom it is for; the last byte is the sender.
_COMMANDED = {0x0008A7: ("PCU1",), 0x0008A8: ("PCU2",), 0x0008FF: SLOTS}
_GROUPS = {key >> 8 for key in (*_BY_KEY, *_COMMAND_BY_KEY)}

STALE_AFTER_MS = {"BMS_Status": 1600, "PCU1_Status2": 200, "PCU2_Status2": 200,
                  "PCU1_Status1": 1600, "PCU2_Status1": 1600}  # fmt: skip
LATE_AFTER_MS = 1100
FUTURE_MS = 20


@dataclass
class Seen:
    """A cause with an effect: since which tick it is not seen any more."""

    absent_since_ns: int | None = None
    until_restart: bool = False


@dataclass
class ReferenceModel:
    """What a second reader of the bus knows."""

    settings: Any
    received: dict = field(default_factory=dict)
    rejected: Counter = field(default_factory=Counter)
    taken: Counter = field(default_factory=Counter)
    arrived: dict = field(default_factory=dict)
    life_repeats: int = 0
    odd: dict = field(default_factory=Counter)
    seen: dict = field(default_factory=dict)
    sent: dict = field(default_factory=dict)
    history: dict = field(default_factory=lambda: {slot: [] for slot in SLOTS})
    held: dict = field(default_factory=dict)
    power_w: dict = field(default_factory=dict)
    brake_pct: dict = field(default_factory=dict)
    granted: list = field(default_factory=list)
    waiting: set = field(default_factory=set)
    apart_since_ns: int | None = None
    regenerates: bool = False
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
        if kind not in (None, "error") and frame.extended:
            for slot in _COMMANDED.get((frame.can_id & _MATCH) >> 8, ()):
                self._command(frame, slot, confirms=False)
        if kind is not None:
            self.rejected[kind] += 1
            return kind
        if command := _COMMAND_BY_KEY.get(frame.can_id & _MATCH):
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
        entry = (bytes(frame.data), frame.arrival_ns)
        self.arrived.setdefault(name, []).append(entry)
        if name.endswith("Status1"):
            latest = before is None or frame.arrival_ns >= before[1]
            self._hold_echo_against_commands(name[:4], *entry, latest)
        if before is not None and frame.arrival_ns < before[1]:
            self.taken["out_of_order"] += 1
            return "out_of_order"
        self.taken["stored"] += 1
        if name == "BMS_Status" and before is not None:
            same = (before[0][7] ^ frame.data[7]) & 0x80 == 0
            self.life_repeats = self.life_repeats + 1 if same else 0
            self._see("life", self.life_repeats)
        if name.endswith("Status2"):
            self._hold_speed_against_the_last(name[:4], before, entry)
        self.received[name] = entry
        return "stored"

    def _hold_echo_against_commands(self, slot, data, at_ns, latest):
        """Frames in a row with too little throttle, or with a direction nobody commanded."""
        told = self.history[slot]
        second = [raw for sent_ns, raw, _ in told if 0 <= at_ns - sent_ns <= 1000 * MS]
        whole = bool(told) and at_ns - told[0][0] >= 1000 * MS
        lack_pct = (min(second, default=0) - data[1]) * PERCENT_PER_BIT
        low = whole and lack_pct > self.settings.echo_below_max_pct
        turned = {back for sent_ns, _, back in told if 0 <= at_ns - sent_ns <= 1100 * MS}
        wrong = bool(turned) and bool(data[0] & 0x10) not in turned
        for kind, odd in (("low", low), ("wrong", wrong)):
            run = self.odd[kind, slot] + 1 if odd else 0
            self._see((kind, slot), run)
            if latest:
                self.odd[kind, slot] = run
            self._see((kind, slot), self.odd[kind, slot])

    def _hold_speed_against_the_last(self, slot, before, entry):
        """A step is doubted until three frames without one."""
        if before is not None:
            speeds = [int.from_bytes(one[0][6:8], "little") for one in (before, entry)]
            near = entry[1] - before[1] <= 100 * MS
            if near and abs(speeds[0] - speeds[1]) > self.settings.motor_speed_step_max_rpm:
                self.odd["step", slot] = 4
        self.odd["step", slot] = max(0, self.odd["step", slot] - 1)
        self._see(("step", slot), self.odd["step", slot])

    def _see(self, what, count):
        self.seen[what] = max(count, self.seen.get(what, 0))

    def worst(self, what):
        """Of the frames since the tick before; where none came, as it stands."""
        standing = self.life_repeats if what == "life" else self.odd[what]
        return self.seen.get(what, standing)

    def end_tick(self):
        """What came before this tick has been judged."""
        self.arrived.clear()
        self.seen.clear()

    def judged(self, name):
        """Every frame since the tick before, or the last one."""
        last = self.received.get(name)
        frames = self.arrived.get(name) or ([last] if last else [])
        return [data for data, _ in frames]

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
            speeds_rpm = [int.from_bytes(data[6:8], "little") for data in self.judged(name)]
            if max(speeds_rpm) > 6000 or max(speeds_rpm) >= self.settings.direction_change_rpm:
                return False
        return not any(self.worst(("step", slot)) for slot in SLOTS)

    def note_speeds(self, now_ns):
        """Regeneration begins 50 rpm above its least speed and ends below it."""
        least_rpm = self.settings.regen_min_rpm
        known = not any(self.stale(f"{slot}_Status2", now_ns) for slot in SLOTS)
        frames = [data for slot in SLOTS for data in self.judged(f"{slot}_Status2")]
        speeds = [int.from_bytes(data[6:8], "little") for data in frames] if known else [9999]
        margin_rpm = 0 if self.regenerates else 50
        fast = all(least_rpm + margin_rpm <= speed <= 6000 for speed in speeds)
        self.regenerates = fast or least_rpm == 0

    def causes(self, now_ns, tick_late_ns, link_down):
        """Names of the causes of this instant, by effect; the worst ones stop or cut."""
        found = {effect: set() for effect in
                 ("turbo_off", "power", "regen", "regen_off", "stop", "cut")}  # fmt: skip
        for data in self.judged("BMS_Status"):
            self._battery_causes(found, data)
        self._age_causes(found, now_ns)
        for slot in SLOTS:
            self._controller_causes(found, slot, now_ns)
        stops = {
            "tick late": tick_late_ns > 4 * self.settings.period_ns,
            "link": link_down,
            "unconfirmed": max(self.silent_ticks.values()) >= 3,
            "foreign": self.foreign,
        }
        found["stop"] |= {name for name, stands in stops.items() if stands}
        return found

    def _battery_causes(self, found, data):
        over, under, current = (data[5] >> shift & 3 for shift in (0, 2, 6))
        hot, cold, internal = data[6] >> 2 & 3, data[6] >> 4 & 3, data[6] >> 7
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
        if self.worst("life") >= 1:
            found["regen"].add("life")
            found["power"].add("life")
        if self.worst("life") >= 2:
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
        for data, arrival_ns in self.arrived.get(name) or [self.received[name]]:
            self._status_causes(found, slot, data, arrival_ns)
        if self.stale(name, now_ns):
            return
        other = SLOTS[1 - SLOTS.index(slot)]
        both = self.odd["low", other] and not self.stale(f"{other}_Status1", now_ns)
        if self.worst(("low", slot)) >= 2 and not both:
            found["stop"].add(f"{slot} echoes too little")
        if self.worst(("wrong", slot)) >= 2:
            found["stop"].add(f"{slot} direction")

    def _status_causes(self, found, slot, data, arrival_ns):
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
            (raw for at_ns, raw, _ in self.history[slot] if 0 <= arrival_ns - at_ns <= 1000 * MS),
            default=0,
        )
        excess_pct = (data[1] - told) * PERCENT_PER_BIT - 5.0
        if excess_pct > 1e-6 and f"{slot}_Status1" not in found["turbo_off"]:  # not stale
            found["stop"].add(f"{slot} echo")

    def hold(self, found, now_ns):
        """Effects that count now: seen now, or gone for less than the holding time."""
        for key, seen in list(self.held.items()):
            if key[1] not in found[key[0]] and seen.absent_since_ns is None:
                seen.absent_since_ns = now_ns
        for effect, names in found.items():
            for name in names:
                self.held[effect, name] = Seen(until_restart=name == "over 3")
        hold_ns = self.settings.clear_hold_ms * MS
        for key, seen in list(self.held.items()):
            absent_since_ns = seen.absent_since_ns
            if seen.until_restart or absent_since_ns is None:
                continue
            if now_ns - absent_since_ns >= hold_ns:
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
            # The highest code stands for everything up to 100 % (docs/protocol.md E10).
            told_pct = 100.0 if data[2] == 255 else data[2] * PERCENT_PER_BIT
            target_w, target_pct = settings.power_limit_max_w, None
            if "power" in effects:
                target_w = min(settings.derated_power_w, target_w)
            if "regen" in effects:
                target_pct = settings.regen_limit_pct
            self.power_w[slot] = _moved(
                self.power_w[slot], told_w, target_w, target_w,
                settings.power_slew_w_per_s * elapsed_s,
            )  # fmt: skip
            self.brake_pct[slot] = _moved(
                self.brake_pct[slot], told_pct, target_pct, 100.0,
                settings.regen_slew_pct_per_s * elapsed_s,
            )  # fmt: skip
            if "regen_off" in effects:
                self.brake_pct[slot] = 0.0

    # Pedals.

    def note_granted(self, demanded, made_ns, now_ns, took_over):
        self.granted.append((demanded, made_ns, now_ns, took_over))

    def note_gap(self):
        """No demand was fresh."""
        self.granted.append(None)

    def throttle_waits(self, demanded, now_ns):
        """Whether a demand since the tick before forbids it, or one before that still does."""
        last = [] if demanded is None else [(demanded, now_ns, now_ns, False)]
        found = set()
        for one in [*self.granted, *(last or [None])]:
            if one is None:
                self.apart_since_ns = None
                continue
            found |= self._waits_after(*one)
        self.granted = []
        return bool(found | self.waiting)

    def _waits_after(self, demanded, made_ns, now_ns, took_over):
        values = demanded.values()
        begun = {"taken over"} if took_over else set()
        if [one for one in values if one.throttle_pct > 25 and one.brake_pct > 5]:
            begun.add("override")
        if self.apart_since_ns is not None and now_ns > self.apart_since_ns + 100 * MS:
            begun.add("tracks")
        self.waiting |= begun
        second = [one.throttle_pct if one.throttle_track2_pct is None else one.throttle_track2_pct
                  for one in values]  # fmt: skip
        first = [one.throttle_pct for one in values]
        if max(abs(a - b) for a, b in zip(first, second, strict=True)) <= 10:
            self.apart_since_ns = None
        elif self.apart_since_ns is None:
            self.apart_since_ns = made_ns
        if max(first) < 5:
            self.waiting -= {"override", "taken over"}
            if max(second) < 5:
                self.waiting.discard("tracks")
        turned = {
            slot for slot, one in demanded.items() if one.motor_reverse is not self.reverse(slot)
        }
        return begun | turned

    def reverse(self, slot):
        """The direction that was sent last."""
        return slot in self.sent and bool(self.sent[slot][0][0] & 0x10)

    # Frames out.

    def note_sent(self, slot, data, now_ns):
        self.sent[slot] = (data, now_ns)
        history = self.history[slot]
        history.append((now_ns, data[1], data[0] & 0x10 != 0))
        del history[:-80]  # as much as anybody has to remember

    def speed_limit_rpm(self, slot, asked_rpm, elapsed_ns):
        """What the frame has to say, within the rounding of two frames."""
        settings = self.settings
        target_rpm = max(500, min(asked_rpm, settings.speed_limit_max_rpm))
        if slot not in self.sent:
            return target_rpm
        before_rpm = int.from_bytes(self.sent[slot][0][4:6], "little")
        elapsed_s = min(max(elapsed_ns, 0), settings.period_ns) / 1e9
        return max(target_rpm, before_rpm - settings.speed_slew_rpm_per_s * elapsed_s)

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


def is_safe(data):
    """ZERO_TORQUE or POWER_CUT: nothing but safety mode, direction, cut and the speed limit."""
    zero = data[1] == data[2] == data[3] == data[6] == data[7] == 0
    return zero and data[0] & ~0x90 == 0x0C
