"""The invariants of docs/safety.md, after every step of a gateway to which anything may happen.

HYPOTHESIS_PROFILE=nightly walks at least 100,000 steps; see tests/conftest.py.
"""

import dataclasses
import math
from collections import Counter

import pytest
from hypothesis import assume, event, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from vcu_gateway.core import calls, why
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import ControllerDemand, Demand, PowerMode
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.schedule import Schedule
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.judge.command_rules import SentFrame
from vcu_gateway.judge.demands import GrantedDemand
from vcu_gateway.judge.judge import Judge
from vcu_gateway.judge.limits import JudgedDemand
from vcu_gateway.judge.result import Findings
from vcu_gateway.judge.wire import COMMAND_IDS as COMMAND_ID_OF
from vcu_gateway.judge.wire import CONTROLLERS as SLOTS
from vcu_gateway.judge.wire import (
    MATCH,
    MS,
    RECEIVED_IDS,
    command_bytes,
    commands_somebody,
    controller_commanded,
    messages,
)
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, packaged
from vcu_gateway.replay.judged import limits_of

ID_OF = {name: can_id for can_id, name in RECEIVED_IDS.items()}
ALL_RECEIVED_IDS = (*RECEIVED_IDS, *DEFAULT_ALIASES)
COMMAND_IDS = tuple(COMMAND_ID_OF.values())
NAME_BY_KEY = messages(DEFAULT_ALIASES)
GROUPS = {key >> 8 for key in (*NAME_BY_KEY, *(can_id & MATCH for can_id in COMMAND_IDS))}
CODEC = Codec(dataclasses.replace(dbc.load(packaged("vcu.dbc")), aliases=DEFAULT_ALIASES))
ORDINARY_EXAMPLES = 90
# How much of a round drives is by chance, 22 to 61 % of some 30,000 ticks: rounds are run until
# a quarter of that many drove, and a tenth had throttle.
DRIVEN_TICKS, THROTTLE_TICKS, MOST_ROUNDS = 7_500, 3_000, 4
KINDS = ("turned", "throttle waits", "braking", "speed limit on its way")
COUNTS: Counter = Counter()
STATUS_PERIOD_NS = 100 * MS

PRIORITIES = {"driver": 1, "remote": 1, "chief": 2}
SETTINGS = st.builds(
    Settings,
    listen_before_talk_ms=st.sampled_from([100, 1000, 2000]),
    clear_hold_ms=st.sampled_from([100, 300, 1000]),
    period_ns=st.sampled_from([50 * MS, 50 * MS, 20 * MS]),
    direction_change_rpm=st.sampled_from([50.0, 20.5, 0.0]),
    throttle_slew_pct_per_s=st.sampled_from([100.0, 200.0, 13.7]),
    power_limit_max_w=st.sampled_from([60_000, 5_000, 0]),
    derated_power_w=st.sampled_from([10_000, 3_333]),
    speed_limit_max_rpm=st.sampled_from([12_000, 3_000]),
    regen_limit_pct=st.sampled_from([20.0, 0.0]),
    speed_slew_rpm_per_s=st.sampled_from([4_000.0, 500.0]),
    regen_min_rpm=st.sampled_from([100.0, 0.0]),
    independent_directions=st.sampled_from([False, False, True]),
    priorities=st.just(PRIORITIES),
)
PERCENT = st.sampled_from([0.0, 3.0, 5.0, 5.01, 25.0, 25.01, 60.0, 100.0]) | st.floats(0, 100)
ASKED = st.builds(
    ControllerDemand,
    throttle_pct=PERCENT,
    brake_pct=st.sampled_from([0.0, 0.0, 5.0, 5.01, 40.0]) | st.floats(0, 100),
    power_mode=st.sampled_from([*PowerMode, *list(PowerMode)[:3], *list(PowerMode)[:3]]),
    motor_reverse=st.sampled_from([False, False, False, True]),
    regen_brake=st.booleans(),
    speed_limit_rpm=st.sampled_from([0.0, 2_999.6, 12_000.0]),
    power_limit_w=st.sampled_from([0.0, 4_000.4, 30_000.0, 60_000.0]),
    throttle_track2_pct=st.sampled_from([None] * 8 + [0.0, 60.0]),
)
WRONG = st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -0.001, 10**400])


def same_direction(both):
    first = both[SLOTS[0]].motor_reverse
    return {slot: dataclasses.replace(one, motor_reverse=first) for slot, one in both.items()}


EACH = st.fixed_dictionaries(dict.fromkeys(SLOTS, ASKED))
BOTH = ASKED.map(lambda one: dict.fromkeys(SLOTS, one)) | EACH.map(same_direction) | EACH
IDLE = dict.fromkeys(SLOTS, ControllerDemand())


class CountedFrames:
    """Frames, sorted by hand into those that the gateway counts (I8)."""

    def __init__(self):
        self.rejected, self.taken = Counter(), Counter()
        self.received_ns = {}

    def receive(self, frame):
        """Sort one frame; the name of the kind it was counted as."""
        kind = self._kind(frame)
        orders = frame.extended and not frame.error and commands_somebody(frame.can_id)
        if orders and not frame.own_echo:
            to_all = frame.can_id >> 8 & 0xFF == 0xFF
            self.taken["foreign"] += len(SLOTS) if to_all else 1
        if kind is not None:
            self.rejected[kind] += 1
            return kind
        if controller_commanded(frame.can_id):
            self.taken["confirmed"] += frame.own_echo
            return "command"
        name = NAME_BY_KEY[frame.can_id & MATCH]
        before_ns = self.received_ns.get(name)
        kind = "stored" if before_ns is None or frame.arrival_ns >= before_ns else "out_of_order"
        self.taken[kind] += 1
        if kind == "stored":
            self.received_ns[name] = frame.arrival_ns
        return kind

    def _kind(self, frame):
        if frame.error or frame.remote:
            return "error" if frame.error else "remote"
        if not frame.extended:
            return "standard_id"
        key = frame.can_id & MATCH
        if key not in NAME_BY_KEY and not controller_commanded(key):
            return "foreign_source" if key >> 8 in GROUPS else "unknown"
        if len(frame.data) != 8:
            return "short" if len(frame.data) < 8 else "long"
        return None


def judged_demand(one):
    return JudgedDemand(
        one.throttle_pct, one.brake_pct, one.power_mode.value, one.motor_reverse, one.regen_brake,
        one.speed_limit_rpm, one.power_limit_w, one.throttle_track2_pct,
    )  # fmt: skip


class GatewayMachine(RuleBasedStateMachine):
    """The gateway, a vehicle around it, and the judge that sees all of it."""

    def __init__(self):
        super().__init__()
        self.now_ns = 5_000_000 * MS
        self.gateway = None
        self.broken = self.ending = False
        self.kept_why = None

    @initialize(settings=SETTINGS, warm=st.sampled_from([True, True, True, True, False]))
    def begin(self, settings, warm):
        self.settings = settings
        self.gateway = self._new_gateway()
        self.counts, self.findings = CountedFrames(), Findings()
        limits = limits_of(settings, DEFAULT_ALIASES)
        self.judge = Judge(limits, self.findings, complete=True)
        self.judge.link_opened(self.now_ns, up=True)
        self.sent: dict = {}
        self.schedule = Schedule(self.now_ns, settings.period_ns)
        self.last_tick_ns = None
        self.demand, self.demand_ns, self.demand_ended = None, 0, False
        self.sequences: Counter = Counter()
        self.granted_sequences: dict = {}
        self.link_lost = False
        self.counted: Counter = Counter()
        self._well()
        if warm:
            for _ in range(200):
                if self.gateway.supervisor.mode is Mode.STANDBY:
                    break
                self._step()

    def _new_gateway(self):
        return Gateway(CODEC, self.settings, self.now_ns)

    def _well(self):
        self.bms = [0, 0]
        self.levels = dict.fromkeys(SLOTS, 0x83)
        self.speeds = dict.fromkeys(SLOTS, 0)
        self.silent, self.refuse, self.mute = set(), set(), set()
        self.life, self.life_stands, self.next_status_ns = 0, False, 0
        self.rogue_throttle = None

    # Frames in.

    def _receive(self, frame):
        store = self.gateway.receiver.store
        before = store._latest.copy()
        kind = self.counts.receive(frame)
        self.judge.frames([frame])
        self.gateway.receive(frame)  # I14: never raises
        if kind != "stored":
            assert store._latest == before, "I14: a frame that is not taken changes nothing"
        COUNTS["frames"] += 1

    def _status(self, name, data, at_ns=None):
        if name not in self.silent:
            at_ns = self.now_ns if at_ns is None else at_ns
            self._receive(Frame(ID_OF[name], bytes(data), at_ns))

    def _vehicle_speaks(self):
        for slot in SLOTS:
            speed = self.speeds[slot]
            data = (0, 26, 0, 0, 0, 0, speed & 255, speed >> 8)
            self._status(f"{slot}_Status2", data, self.now_ns - 3 * MS)
        if self.now_ns < self.next_status_ns:
            return
        self.next_status_ns = self.now_ns + STATUS_PERIOD_NS
        if not self.life_stands:
            self.life ^= 0x80
        self._status("BMS_Status", (0x88, 0x13, 0, 0, 80, *self.bms, self.life | 2))
        for slot in SLOTS:
            told = self.sent.get(slot, bytes(8))
            first, throttle = told[0] & 0x10, told[1]
            if self.rogue_throttle is not None:
                throttle = self.rogue_throttle
            self._status(f"{slot}_Status1", (first, throttle, 0, self.levels[slot], 0, 0, 30, 30))

    # Demands.

    def _fresh(self):
        if self.demand is None or self.demand_ended:
            return False
        return 0 <= self.now_ns - self.demand_ns <= self.demand.ttl_ms * MS

    def _offer(self, controllers, source="driver", ttl_ms=200, sequence=None, made_ns=None):
        if sequence is None:
            self.sequences[source] += 1
            sequence = self.sequences[source]
        demand = Demand(source, sequence, ttl_ms, controllers, made_ns)
        was_fresh, before = self._fresh(), self.demand
        was = self.gateway.supervisor.mode
        self.judge.offered(self.now_ns)
        answer = self.gateway.apply(calls.Offer(demand, self.now_ns))
        self._check_lateness(was)
        if not was_fresh:
            assert self.gateway.supervisor.mode is not Mode.ACTIVE, "it expired in between"
        others = before is not None and before.source != source
        if others and was_fresh and answer.granted:
            assert PRIORITIES[source] > PRIORITIES[before.source], "one owner at a time"
        if answer.granted:
            self._check_granted(demand)
            made_ns = self.now_ns if made_ns is None else made_ns
            self._note_granted(demand, made_ns)
        return answer

    def _check_lateness(self, was):
        """A request that comes when the tick is overdue finds the drive stopped, or stops it."""
        late_ns = self.now_ns - (self.last_tick_ns or self.now_ns) - self.settings.period_ns
        is_late = was is Mode.ACTIVE and late_ns > 4 * self.settings.period_ns
        if is_late:
            assert self.gateway.supervisor.mode is Mode.FAULT, "late, whatever is asked"
        return is_late

    def _check_granted(self, demand):
        last = self.granted_sequences.get(demand.source, -math.inf)
        assert demand.sequence > last, "an old one is refused"
        directions = {one.motor_reverse for one in demand.controllers.values()}
        assert len(directions) == 1 or self.settings.independent_directions
        for one in demand.controllers.values():
            assert 0 <= one.throttle_pct <= 100
            assert 0 <= one.brake_pct <= 100
            assert 0 <= one.speed_limit_rpm <= 12_000
            assert 0 <= one.power_limit_w <= 60_000
        assert 0 < demand.ttl_ms <= self.settings.ttl_max_ms

    def _note_granted(self, demand, made_ns):
        age_ns = self.now_ns - made_ns
        assert 0 <= age_ns <= demand.ttl_ms * MS, "it counts from when it was made"
        self.demand, self.demand_ns, self.demand_ended = demand, made_ns, False
        self.granted_sequences[demand.source] = demand.sequence
        judged = {slot: judged_demand(one) for slot, one in demand.controllers.items()}
        granted = GrantedDemand(demand.source, judged, made_ns, demand.ttl_ms)
        self.judge.demand(granted, self.now_ns)

    def _arm(self):
        before = self.gateway.supervisor.mode
        answer = self.gateway.apply(calls.Arm(self.now_ns))
        if answer.granted:
            assert before is Mode.STANDBY
            self.judge.armed(self.now_ns)
            self._check_judged()
        else:
            assert answer.sentence
            if not self._check_lateness(before):
                assert self.gateway.supervisor.mode is before
        return answer

    def _reset(self, level):
        before = self.gateway.supervisor.mode
        answer = self.gateway.apply(calls.Reset(level, self.now_ns))
        after = self.gateway.supervisor.mode
        if answer.granted:
            assert (before, after) == (Mode.FAULT, Mode.STARTING), "never to ACTIVE"
            self.judge.reset(self.now_ns, service=level is FaultClass.SERVICE)
            self._check_judged()
        else:
            assert after is before
        return answer

    # The tick and its checks.

    def _step(self, demanded=None, after_ns=None, *, speak=True, **offer):
        """One turn of the loop, at the next grid point or after a given time."""
        if after_ns is None:
            self.now_ns = max(self.now_ns, self.schedule.next_deadline_ns)
        else:
            self.now_ns += after_ns
        if speak:
            self._vehicle_speaks()
        if demanded is not None:
            self._offer(demanded, **offer)
        if self.schedule.due(self.now_ns) is None:
            return None
        return self._tick()

    def _tick(self):
        self.broken = True
        self.last_tick_ns = self.now_ns
        result = self.gateway.tick(self.now_ns)
        COUNTS["ticks"] += 1
        COUNTS[result.mode] += 1
        self.counted[result.mode] += 1
        assert result.mode is self.gateway.supervisor.mode
        assert not self.ending or result.mode is Mode.STOPPING
        assert result.snapshot.now_ns == self.now_ns, "I5"
        assert self.gateway.transmitter.gate.blocked == {}, "the gate never has to act"
        sent = {
            frame.controller: SentFrame(frame.can_id, bytes(frame.data), self._leaves(frame))
            for frame in result.frames
        }
        self.judge.tick(self.now_ns, result.mode.value, sent)
        self._check_judged()
        for frame in result.frames:
            self._check_content(result.commands[frame.controller], frame)
            self._count_kinds(frame, result.mode is Mode.ACTIVE)
        self._check_why()
        self._send(result)
        self.broken = False
        return result

    def _leaves(self, frame):
        return frame.controller not in self.refuse and not self.link_lost

    def _check_judged(self):
        """The machine hands over frames with old stamps, which nobody can answer in time."""
        broken = [one for one in self.findings.kept if one.rule != "reaction time"]
        assert not broken, "\n".join(map(str, broken))

    def _count_kinds(self, frame, active):
        """What the machine has to come upon, lest it proves little."""
        command, before = command_bytes(frame.data), self.sent.get(frame.controller, bytes(8))
        COUNTS["turned"] += command.reverse != bool(before[0] & 0x10)
        asked_rpm = self.settings.speed_limit_max_rpm
        if active:
            demanded = self.demand.controllers[frame.controller]
            asked_rpm = max(demanded.speed_limit_rpm, 500)
            COUNTS["throttle waits"] += demanded.throttle_pct > 5 and not command.throttle_raw
        COUNTS["with throttle"] += command.throttle_raw > 0
        COUNTS["braking"] += command.brake_raw > 0
        COUNTS["speed limit on its way"] += command.speed_limit_rpm > asked_rpm + 1

    def _check_why(self):
        """What was kept at the tick before reads as it was then."""
        if self.kept_why is not None:
            reasons, ages, explanation = self.kept_why
            assert why.explained(reasons, *ages) == explanation
        demand_age_ns = self.gateway.requests.arbiter.age_ns(self.now_ns)
        ages = self.now_ns, self.now_ns, demand_age_ns
        self.kept_why = self.gateway.reasons(self.now_ns), ages, self.gateway.why(self.now_ns)

    def _check_content(self, command, frame):
        """I5, I15: the frame is this tick's command, within half a bit."""
        codec = CODEC.by_name[f"VCU_{frame.controller}_Command"]
        decoded = dict(zip(codec.spec.signal_names, codec.decode(frame.data).values, strict=True))
        for name, value in command.signals().items():
            half = {"Throttle": 0.196, "Brake": 0.196}.get(name, 0.501)
            highest = 99.45 if name in ("Throttle", "Brake") else math.inf
            assert abs(decoded[name] - min(value, highest)) <= half
        assert codec.encode(decoded) == frame.data

    def _send(self, result):
        for frame in result.frames:
            ok = self._leaves(frame)
            self.gateway.apply(calls.NoteSent(frame, ok, self.now_ns))
            if ok:
                self.sent[frame.controller] = frame.data
            if ok and frame.controller not in self.mute:
                self._receive(Frame(frame.can_id, frame.data, self.now_ns + MS, own_echo=True))

    # Ordinary life.

    @rule(demanded=BOTH, ticks=st.integers(1, 12))
    def drive(self, demanded, ticks):
        for _ in range(ticks):
            self._step(demanded)

    @rule(legs=st.lists(BOTH, min_size=1, max_size=4), ticks=st.integers(5, 25))
    def set_off(self, legs, ticks):
        """Make everything well, reset, arm and drive."""
        self._make_well()
        self._settle()
        for demanded in legs:
            self.drive(demanded, ticks)

    @rule(legs=st.lists(BOTH, min_size=1, max_size=4), ticks=st.integers(5, 25))
    def drive_on(self, legs, ticks):
        """As set_off, and with what the vehicle tells where that stops nothing."""
        if self.gateway.supervisor.mode is not Mode.ACTIVE:
            self.set_off(legs, ticks)
        for demanded in legs:
            self.drive(IDLE, 1)  # a released pedal ends what the leg before it latched
            self.drive(demanded, ticks)

    @rule(demanded=BOTH, slot=st.sampled_from(SLOTS), other=ASKED, ticks=st.integers(5, 25))
    def steer(self, demanded, slot, other, ticks):
        """Drive, then ask something else of one controller."""
        self.drive_on([demanded, demanded | {slot: other}, demanded], ticks)

    def _make_well(self):
        self._well()
        self.link_lost = False
        self.gateway.apply(calls.OpenLink(LinkStatus(LinkState.UP, self.now_ns), None, self.now_ns))
        self.judge.link_opened(self.now_ns, up=True)

    def _settle(self):
        """Healthy ticks until ACTIVE is granted, at most as long as anything is held."""
        for _ in range(200):
            mode = self.gateway.supervisor.mode
            if mode is Mode.ACTIVE or self._step(IDLE, source=self._owner()) is None:
                break
            if self.gateway.supervisor.mode is Mode.FAULT:
                self._reset(FaultClass.SERVICE)
            elif self.gateway.supervisor.mode is Mode.STANDBY and self._arm().granted:
                break

    def _owner(self):
        return self.demand.source if self._fresh() else "driver"

    @rule(ticks=st.integers(1, 8))
    def nobody_asks(self, ticks):
        for _ in range(ticks):
            self._step()

    @rule()
    def arm(self):
        self._arm()

    @rule()
    def disarm(self):
        was = self.gateway.supervisor.mode
        self.gateway.apply(calls.Disarm(self.now_ns))
        self._check_lateness(was)
        self.judge.disarmed()
        assert self.gateway.supervisor.mode is not Mode.ACTIVE

    @rule(level=st.sampled_from(FaultClass))
    def reset(self, level):
        self._reset(level)

    @rule()
    def press_emergency_stop(self):
        assert self.gateway.apply(calls.EmergencyStop()).granted
        self.judge.emergency_stop()

    @rule(speeds=st.lists(st.sampled_from([0, 0, 19, 20, 21, 49, 50, 3000, 6001]), min_size=2))
    def roll(self, speeds):
        self.speeds = dict(zip(SLOTS, speeds, strict=False))

    # What the vehicle tells.

    @rule(byte6=st.integers(0, 255), demanded=BOTH, ticks=st.integers(1, 8))
    def battery_tells(self, byte6, demanded, ticks):
        self.bms[0] = byte6
        self.drive(demanded, ticks)

    @rule(byte6=st.sampled_from([0x01, 0x02, 0x03, 0x04, 0x40]), demanded=BOTH)
    def battery_limits(self, byte6, demanded):
        """Level 1 for a while and then no more: limits come and go."""
        self.bms[0] = byte6
        for _ in range(12):
            self._step(demanded)
        self.bms[0] = 0
        for _ in range(25):
            self._step(demanded)

    @rule(byte7=st.integers(0, 255) | st.sampled_from([0x04, 0x10, 0x40]), ticks=st.integers(1, 4))
    def battery_feels(self, byte7, ticks):
        self.bms[1] = byte7
        self.nobody_asks(ticks)

    @rule(slot=st.sampled_from(SLOTS), level=st.integers(0, 255), demanded=BOTH)
    def controller_tells(self, slot, level, demanded):
        self.levels[slot] = level
        self.drive(demanded, 4)

    @rule(names=st.sets(st.sampled_from(sorted(ID_OF)), max_size=3), demanded=BOTH)
    def fall_silent(self, names, demanded):
        self.silent = names
        self.drive(demanded, 5)

    @rule(demanded=BOTH, ticks=st.integers(1, 8))
    def life_stands_still(self, demanded, ticks):
        self.life_stands = True
        self.drive(demanded, ticks)
        self.life_stands = False

    @rule(throttle=st.integers(0, 255))
    def controllers_echo(self, throttle):
        self.rogue_throttle = throttle
        self.nobody_asks(3)
        self.rogue_throttle = None

    @rule()
    def all_is_well_again(self):
        self._make_well()

    # What the bus throws at it.

    @rule(
        can_id=st.integers(0, 2**29 - 1) | st.sampled_from(sorted(ALL_RECEIVED_IDS)),
        data=st.binary(max_size=64),
        offset_ns=st.integers(-3_000 * MS, 15 * MS),
        flags=st.fixed_dictionaries(
            {}, optional=dict.fromkeys(("remote", "own_echo"), st.booleans())
        ),
        extended=st.sampled_from([True, True, True, False]),
    )
    def any_frame(self, can_id, data, offset_ns, flags, extended):
        at_ns = self.now_ns + offset_ns
        self._receive(Frame(can_id, data, at_ns, extended=extended, **flags))

    @rule(
        can_id=st.sampled_from(sorted(ALL_RECEIVED_IDS)),
        data=st.binary(min_size=8, max_size=8),
        priority=st.integers(0, 7),
        offset_ns=st.sampled_from([0, 0, 0, -1, -50 * MS, -(10**12), 20 * MS, 20 * MS + 1]),
    )
    def mutated_message(self, can_id, data, priority, offset_ns):
        can_id = can_id & 0x03FF_FFFF | priority << 26
        self._receive(Frame(can_id, data, self.now_ns + offset_ns))

    @rule(
        can_id=st.sampled_from(sorted(COMMAND_IDS)),
        length=st.sampled_from([8, 8, 8, 0, 7, 9]),
        priority=st.integers(0, 7),
        remote=st.sampled_from([False, False, False, True]),
        source=st.just(0xD0) | st.integers(0, 255),
        to_all=st.sampled_from([False, False, False, True]),
    )
    def somebody_commands(self, can_id, length, priority, remote, source, to_all):
        data = b"" if remote else bytes(length)
        can_id = (0x0008FF00 if to_all else can_id & ~0xFF) | source
        self._receive(Frame(can_id | priority << 26, data, self.now_ns, remote=remote))
        self._step()

    @rule(bits=st.sampled_from([0x40, 0x100, 0x004, 0x002]), second=st.integers(0, 255))
    def error_frame(self, bits, second):
        data = bytes((0, second & 0x4C, 0, 0, 0, 0, 0, 0))
        self._receive(Frame(bits, data, self.now_ns, error=True))

    @rule(refuse=st.sets(st.sampled_from(SLOTS)), demanded=BOTH, ticks=st.integers(1, 6))
    def bus_does_not_take(self, refuse, demanded, ticks):
        self.refuse = refuse
        self.drive(demanded, ticks)
        self.refuse = set()

    @rule(mute=st.sets(st.sampled_from(SLOTS)), demanded=BOTH, ticks=st.integers(1, 5))
    def frames_do_not_come_back(self, mute, demanded, ticks):
        self.mute = mute
        self.drive(demanded, ticks)
        self.mute = set()

    @rule(ticks=st.integers(0, 5))
    def link_goes(self, ticks):
        self.gateway.apply(calls.LoseLink(self.now_ns))
        self.judge.link_lost(self.now_ns)
        self.link_lost = True
        self.nobody_asks(ticks)

    # Time.

    @rule(after_ns=st.integers(0, 60 * MS), demanded=BOTH)
    def some_time_passes(self, after_ns, demanded):
        self._step(demanded, after_ns=after_ns)

    @rule(periods=st.sampled_from([1, 2, 4, 5, 6, 40, 10_000]), jitter_ns=st.integers(0, 49 * MS))
    def the_tick_is_late(self, periods, jitter_ns):
        self._step(None, after_ns=periods * self.settings.period_ns + jitter_ns)

    @rule(demanded=BOTH, lateness_ns=st.lists(st.integers(0, 26 * MS), max_size=8))
    def ticks_jitter(self, demanded, lateness_ns):
        for one in lateness_ns:
            after_ns = max(self.schedule.next_deadline_ns - self.now_ns, 0) + one
            self._step(demanded, after_ns=after_ns)

    # What the operators do.

    @rule(
        demanded=BOTH,
        slot=st.sampled_from(SLOTS),
        name=st.sampled_from(["throttle_pct", "brake_pct", "speed_limit_rpm", "power_limit_w"]),
        value=WRONG,
    )
    def ask_the_impossible(self, demanded, slot, name, value):
        wrong = demanded | {slot: dataclasses.replace(demanded[slot], **{name: value})}
        assert not self._offer(wrong).granted

    @rule(demanded=BOTH, ttl_ms=st.sampled_from([-1, 0, 1, 20, 50, 1000, 1001]))
    def ask_for_a_time(self, demanded, ttl_ms):
        self._step(demanded, ttl_ms=ttl_ms)
        self._step()

    @rule(demanded=BOTH, back=st.integers(0, 3))
    def ask_with_an_old_number(self, demanded, back):
        self._offer(demanded, sequence=self.sequences["driver"] - back)

    @rule(demanded=BOTH, waited_ns=st.integers(-5 * MS, 400 * MS), ticks=st.integers(1, 8))
    def ask_with_a_demand_that_waited(self, demanded, waited_ns, ticks):
        self._offer(demanded, made_ns=self.now_ns - waited_ns)
        for _ in range(ticks):
            self._step()

    @rule(source=st.sampled_from(sorted(PRIORITIES)))
    def end_the_demand(self, source):
        owner = self.demand is not None and self.demand.source == source
        answer = self.gateway.apply(calls.EndDemand(source, self.now_ns))
        assert answer.granted is owner, "nobody ends another's demand"
        if owner:
            self.demand_ended = True
            self.judge.end_demand()
            assert self.gateway.supervisor.mode is not Mode.ACTIVE

    @rule(demanded=BOTH, source=st.sampled_from(sorted(PRIORITIES)), ticks=st.integers(1, 4))
    def another_source_asks(self, demanded, source, ticks):
        for _ in range(ticks):
            self._step(demanded, source=source)

    @rule(
        name=st.sampled_from(
            [
                "speed_limit_max_rpm",
                "power_limit_max_w",
                "derated_power_w",
                "regen_limit_pct",
                "throttle_slew_pct_per_s",
                "direction_change_rpm",
                "clear_hold_ms",
            ]
        ),
        stricter=st.booleans(),
    )
    def reload(self, name, stricter):
        value = getattr(self.settings, name)
        up = stricter is (name == "clear_hold_ms")
        limit = {"speed_limit_max_rpm": 12_000, "power_limit_max_w": 60_000}.get(name, 10**6)
        least = 500 if name == "speed_limit_max_rpm" else 0
        new = min(value * 2 + 1, limit) if up else max(value // 2, least)
        assume(name != "clear_hold_ms" or new < 3000)
        after = dataclasses.replace(self.settings, **{name: new})
        active = self.gateway.supervisor.mode is Mode.ACTIVE
        answer = self.gateway.apply(calls.ReloadSettings(after))
        assert answer.granted is (stricter or not active or new == value)
        if answer.granted:
            self.settings = after
            self.judge.reload(limits_of(after, DEFAULT_ALIASES))
        assert self.gateway.settings == self.settings

    @rule(change=st.sampled_from([{"period_ns": 1}, {"auto_arm": True}, {"transmit_priority": 7}]))
    def reload_what_needs_a_restart(self, change):
        assert not self.gateway.apply(
            calls.ReloadSettings(dataclasses.replace(self.settings, **change))
        ).granted
        assert self.gateway.settings == self.settings

    # Always.

    @precondition(lambda self: self.gateway is not None)
    @invariant()
    def everything_is_counted_and_bounded(self):
        COUNTS["steps"] += 1
        receiver, counts = self.gateway.receiver, self.counts
        rejected = {reason.value: n for reason, n in receiver.rejected.items() if n}
        assert rejected == dict(counts.rejected), "I8"
        assert receiver.foreign_count == counts.taken["foreign"]
        assert sum(receiver.confirmed.values()) == counts.taken["confirmed"]
        assert receiver.store.out_of_order == counts.taken["out_of_order"]
        stored = sum(latest.frame_count for latest in receiver.store._latest.values())
        assert stored == counts.taken["stored"]
        assert len(receiver.store._latest) <= len(ID_OF), "I9"
        assert len(self.gateway.causes.held) <= 100, "I9: as many as there are"
        assert len(self.gateway._modes._events) <= 60, "I9"
        for frames in self.gateway.transmitter.history.frames.values():
            assert len(frames) <= 80, "I9"

    @precondition(lambda self: self.gateway is not None)
    @invariant()
    def why_answers(self):
        sentence = self.gateway.why(self.now_ns).sentence()
        assert sentence.startswith(self.gateway.supervisor.mode.value)
        assert "\n" not in sentence

    def teardown(self):
        if self.gateway is None or self.broken:
            return
        ticks = max(self.counted.total(), 1)
        share = self.counted[Mode.ACTIVE] / ticks
        event(f"ACTIVE in {int(share * 5) * 20} % and more of the ticks")
        self._end()

    def _end(self):
        """STOPPING: at least three safe frames that leave, or ten ticks, and then the end."""
        self.gateway.apply(calls.Terminate())
        self.ending = True
        for count in range(1, 11):
            result = self._step(IDLE, source=self._owner())
            assert result is not None
            assert result.mode is Mode.STOPPING
            left = 0 if self.link_lost else count
            finished = left >= 3 or count == 10 or not result.frames
            assert self.gateway.finished is finished
            if finished:
                break


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("share", [0.3, pytest.param(1, marks=pytest.mark.ci)])
def test_the_invariants_hold_whatever_happens(share):
    COUNTS.clear()
    nightly = settings().max_examples > 1000
    for _ in range(MOST_ROUNDS):
        _run_machine(nightly, share)
        if _drove_enough(share):
            break
    active = COUNTS[Mode.ACTIVE] / COUNTS["ticks"]
    shown = {getattr(key, "value", key): count for key, count in COUNTS.items()}
    print(f"\ninvariants: {shown}, {active:.0%} of the ticks in ACTIVE")
    assert COUNTS["steps"] >= (100_000 if nightly else 3_000) * share
    assert _drove_enough(share), "the machine must drive, not only stand"


def _drove_enough(share):
    driven = COUNTS[Mode.ACTIVE] >= DRIVEN_TICKS * share
    pushed = COUNTS["with throttle"] >= THROTTLE_TICKS * share
    return driven and pushed and all(COUNTS[kind] > 0 for kind in KINDS)


def _run_machine(nightly, share):
    run_state_machine_as_test(
        GatewayMachine,
        settings=settings(
            max_examples=round((settings().max_examples if nightly else ORDINARY_EXAMPLES) * share),
            stateful_step_count=100 if nightly else 50,
            deadline=None,
            print_blob=True,
            report_multiple_bugs=False,
        ),
    )


FRAMES = st.builds(
    Frame,
    can_id=st.integers(0, 2**32 - 1) | st.sampled_from([*ALL_RECEIVED_IDS, *COMMAND_IDS]),
    data=st.binary(max_size=64) | st.binary(min_size=8, max_size=8),
    arrival_ns=st.integers(-(10**18), 10**18),
    extended=st.booleans(),
    remote=st.booleans(),
    error=st.booleans(),
    own_echo=st.booleans(),
)


@given(frames=st.lists(FRAMES, max_size=20))
def test_receiving_never_raises_and_counts_every_frame(frames):
    receiver = Gateway(CODEC, Settings(), 0).receiver
    counts = CountedFrames()
    for frame in frames:
        counts.receive(frame)
        receiver.receive(frame)
    assert {reason.value: n for reason, n in receiver.rejected.items() if n} == counts.rejected
    stored_ns = {name: latest.arrival_ns for name, latest in receiver.store._latest.items()}
    assert stored_ns == counts.received_ns


@given(data=st.binary(min_size=8, max_size=8), name=st.sampled_from(sorted(CODEC.by_name)))
def test_decoding_any_eight_bytes_and_encoding_again_is_stable(data, name):
    codec = CODEC.by_name[name]
    names = codec.spec.signal_names
    decoded = codec.decode(data)
    again = codec.decode(codec.encode(dict(zip(names, decoded.values, strict=True))))
    for index, signal in enumerate(codec.spec.signals):
        if signal.raw_minimum <= decoded.raws[index] <= signal.raw_maximum:
            assert again.raws[index] == decoded.raws[index]
        else:
            assert again.raws[index] in (signal.raw_minimum, signal.raw_maximum)


@given(data=st.data(), name=st.sampled_from(sorted(CODEC.by_name)))
def test_encoding_and_decoding_is_the_identity_within_half_a_bit(data, name):
    codec = CODEC.by_name[name]
    values = {
        signal.name: data.draw(
            st.floats(
                signal.raw_minimum * signal.factor + signal.offset,
                signal.raw_maximum * signal.factor + signal.offset,
            ),
            signal.name,
        )
        for signal in codec.spec.signals
    }
    decoded = codec.decode(codec.encode(values))
    for index, signal in enumerate(codec.spec.signals):
        half = abs(signal.factor) * 0.5 * (1 + 1e-6) + 1e-9
        assert abs(decoded.values[index] - values[signal.name]) <= half
