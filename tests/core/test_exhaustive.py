"""Every word of the battery and of the controllers, in every mode, against an oracle.

The oracle is docs/safety.md, written down once more as text and read here; it imports nothing of
the rules, the supervisor's table or the commands. Each case is one whole tick of a gateway
that is put back, before the case, into the state in which it was prepared:

- BMS_Status: all 65,536 values of bytes 6 and 7 in ACTIVE. In the four other modes all
  16,384 values of the bits that mean something, with the two reserved bits taking turns.
- PCU1_Status1 and PCU2_Status1: all 256 values of byte 4 of each controller in each mode,
  and in ACTIVE all 1,024 pairs of the levels of the two.
- In ACTIVE every one of those words of the three messages once more, with good frames before
  it, after it, and both, within the same tick.
- All 128 sets of effects in ACTIVE, through the battery and both controllers at once.

Checked are the set of effects, the mode, the class of the latch, whether `arm` is granted,
and every byte of both frames.
"""

import re
from collections import deque
from dataclasses import is_dataclass
from enum import Enum
from functools import cache
from itertools import combinations, product
from typing import Any

import pytest

from tests.core.simulated_drive import CODEC, PERIOD_NS, data, in_mode
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.supervisor import Mode

# The oracle. First number: byte; second: lowest bit; third: bits; then code: effects. A
# reserved code of the battery also is a signal out of range in a required message: ALARM.

SAFETY_PAGE = """
battery
  6 0 2  1: REGEN_LIMIT           2: REGEN_OFF      3: REGEN_OFF
  6 2 2  1: POWER_LIMIT           2: STOP           3: CUT
  6 6 2  1: REGEN_LIMIT POWER_LIMIT  2: CUT         3: CUT ALARM
  7 0 2  1: ALARM                 2: ALARM          3: ALARM
  7 2 2  1: ALARM                 2: CUT            3: CUT ALARM
  7 4 2  1: REGEN_OFF             2: CUT            3: CUT ALARM
  7 6 1  1: ALARM
  7 7 1  1: CUT
controller
  4 5 2  1: TURBO_OFF             2: STOP           3: STOP
  4 0 3  1: POWER_LIMIT           5: REGEN_OFF      0: POWER_LIMIT REGEN_OFF
         6: POWER_LIMIT REGEN_OFF                   7: POWER_LIMIT REGEN_OFF
"""

FIELDS = {"battery": [], "controller": []}
for _line in SAFETY_PAGE.strip().splitlines():
    _words = _line.split()
    if _line in FIELDS:
        _fields = FIELDS[_line]
        continue
    if _words[0].isdigit():
        _fields.append((*map(int, _words[:3]), {}))
    for _code, _effects in re.findall(r"(\d): ([A-Z_ ]+?)(?=\s\s|$)", _line):
        _fields[-1][3][int(_code)] = frozenset(_effects.split())


@cache
def expected_effects(node: str, bytes_by_number: tuple[tuple[int, int], ...]) -> frozenset[str]:
    """What the page says of these bytes."""
    found, values = set(), dict(bytes_by_number)
    for number, bit, bits, effects in FIELDS[node]:
        found |= effects.get(values[number] >> bit & (1 << bits) - 1, frozenset())
    return frozenset(found)


def expected_mode(mode: str, effects: frozenset[str]) -> str:
    if mode == "STOPPING":
        return mode
    if "CUT" in effects or ("STOP" in effects and mode == "ACTIVE"):
        return "FAULT"
    return mode


def expected_latch(mode: str, effects: frozenset[str]) -> str | None:
    """The class of the latch; the drive in FAULT was latched for the driver to reset.

    While ending a CUT alone is latched: for the next start.
    """
    if "CUT" in effects:
        return "SERVICE"
    return "DRIVER" if expected_mode(mode, effects) == "FAULT" else None


def expected_frame(mode: str, effects: frozenset[str]) -> bytes:
    """One tick after a drive with ASKED: throttle 51 bits, brake 154 bits, 60000 W, turbo."""
    power_mode, regen, cut, throttle, brake, power_w = 3, 0, 0, 0, 0, 0
    if "CUT" in effects:
        cut = 1
    elif mode == "ACTIVE" and "STOP" not in effects:
        power_mode, regen, throttle, brake, power_w = 2, 1, 51, 154, 60000
        if "TURBO_OFF" in effects:
            power_mode = 1
        if "POWER_LIMIT" in effects:
            power_mode, power_w = 0, 60000 - 60000 // 20  # 60000 W/s for 50 ms
        if "REGEN_LIMIT" in effects:
            brake = round((60 - 100 / 20) / 0.39)  # 100 %/s for 50 ms
        if "REGEN_OFF" in effects:
            regen = brake = 0
    first = power_mode << 2 | regen << 5 | cut << 7
    return bytes([first, throttle, brake, 0]) + (12000).to_bytes(2, "little") + (
        power_w.to_bytes(2, "little")
    )  # fmt: skip


# The gateway, put back before each case.

ASKED = ControllerDemand(
    throttle_pct=20, brake_pct=60, power_mode=PowerMode.TURBO, regen_brake=True
)  # a little throttle, so that the brake does not override it


class Checkpoint:
    """The state of an object and of all that it owns, to be put back at little cost."""

    def __init__(self, root: object) -> None:
        self._kept: list[tuple[Any, Any]] = []
        self._seen: set[int] = set()
        self._keep(root)

    def _keep(self, owner: Any) -> None:
        if id(owner) in self._seen or isinstance(owner, Enum | Codec | type) or callable(owner):
            return
        self._seen.add(id(owner))
        if isinstance(owner, dict):
            self._note(owner, dict(owner), owner.values())
        elif isinstance(owner, list | deque | set):
            self._note(owner, list(owner), owner)
        elif isinstance(owner, tuple):
            for part in owner:
                self._keep(part)
        elif type(owner).__module__.startswith("vcu_gateway.core"):
            if is_dataclass(owner) and owner.__dataclass_params__.frozen:
                return
            names = getattr(owner, "__dict__", None) or getattr(owner, "__slots__", ())
            values = {name: getattr(owner, name) for name in names}
            self._note(owner, values, values.values())

    def _note(self, owner: Any, content: Any, parts: Any) -> None:
        self._kept.append((owner, content))
        for part in tuple(parts):
            self._keep(part)

    def restore(self) -> None:
        for owner, content in self._kept:
            if isinstance(owner, dict | set):
                owner.clear()
                owner.update(content)
            elif isinstance(owner, list | deque):
                owner.clear()
                owner.extend(content)
            else:
                for name, value in content.items():
                    setattr(owner, name, value)


class Prepared:
    """A gateway in one mode, healthy, and what one more tick makes of one more frame."""

    def __init__(self, mode: Mode) -> None:
        drive = in_mode(mode)
        if mode is Mode.ACTIVE:
            drive.turn(3000)
            drive.demanded = ASKED
            drive.run(2000)
            assert drive.commands == [expected_frame("ACTIVE", frozenset())] * 2
        assert drive.mode is mode
        assert drive.gateway.causes.held == ()
        self.mode, self.gateway, self.now_ns = mode.name, drive.gateway, drive.now_ns + PERIOD_NS
        last = drive.gateway.snapshot(0).reading("BMS_Status", "LifeSignal").raw
        self.life = (last or 0) ^ 1
        self._checkpoint = Checkpoint(self.gateway)

    def tick(self, *frames: tuple[str, bytes]) -> TickResult:
        self._checkpoint.restore()
        for name, content in frames:
            can_id = CODEC.by_name[name].spec.can_id
            self.gateway.receive(Frame(can_id, content, self.now_ns))
        return self.gateway.tick(self.now_ns)

    def battery(self, byte6: int, byte7: int, number: int = 0) -> tuple[str, bytes]:
        """The frame of this number in a row."""
        content = bytearray(data("BMS_Status", {"LifeSignal": self.life ^ number & 1}))
        content[5:7] = byte6, byte7
        return "BMS_Status", bytes(content)

    def check(self, effects: frozenset[str], *frames: tuple[str, bytes]) -> None:
        """One tick with these frames does what the page says of these effects."""
        result = self.tick(*frames)
        supervisor = self.gateway.supervisor
        latch = supervisor.latch and supervisor.latch.fault_class.name
        found = (
            {effect.name for effect in self.gateway.causes.effects()},
            result.mode.name,
            latch,
            [frame.data for frame in result.frames],
        )
        expected = (
            effects,
            expected_mode(self.mode, effects),
            expected_latch(self.mode, effects),
            [expected_frame(self.mode, effects)] * 2,
        )
        assert found == expected, [content.hex() for _, content in frames]
        if self.mode == "STANDBY":
            arms = self.gateway.requests.arm(self.now_ns).granted
            assert arms == effects.isdisjoint({"STOP", "CUT"}), frames


@pytest.fixture(scope="module", params=Mode, ids=lambda mode: mode.name)
def prepared(request):
    return Prepared(request.param)


@pytest.fixture(scope="module")
def driving():
    return Prepared(Mode.ACTIVE)


def controller(name: str, byte4: int, throttle: int = 0) -> tuple[str, bytes]:
    content = bytearray(data(f"{name}_Status1", {"Throttle": throttle}))
    content[3] = byte4
    return f"{name}_Status1", bytes(content)


def test_the_oracle_is_complete():
    """Every code of every field has a word, but for those that mean no harm."""
    said = {node: [(*f[:3], sorted(f[3])) for f in fields] for node, fields in FIELDS.items()}
    assert said["battery"] == [
        (6, 0, 2, [1, 2, 3]), (6, 2, 2, [1, 2, 3]), (6, 6, 2, [1, 2, 3]), (7, 0, 2, [1, 2, 3]),
        (7, 2, 2, [1, 2, 3]), (7, 4, 2, [1, 2, 3]), (7, 6, 1, [1]), (7, 7, 1, [1]),
    ]  # fmt: skip
    assert said["controller"] == [(4, 5, 2, [1, 2, 3]), (4, 0, 3, [0, 1, 5, 6, 7])]
    bits = {
        (number, bit + i) for number, bit, length, _ in FIELDS["battery"] for i in range(length)
    }
    every = {(number, bit) for number in (6, 7) for bit in range(8)}
    assert every - bits == {(6, 4), (6, 5)}, "the reserved bits"


def test_a_prepared_gateway_is_put_back_exactly(prepared):
    """Without this the cases below could depend on each other."""
    healthy = prepared.tick(prepared.battery(0, 0))
    for byte6, byte7 in ((0x0C, 0), (0x03, 0x80), (0x41, 0x01)):
        broken = prepared.tick(prepared.battery(byte6, byte7), controller("PCU1", 0xFF))
        prepared.gateway.requests.emergency_stop()
        for frame in broken.frames:
            prepared.gateway.sent(frame, byte6 == 0x0C, prepared.now_ns)
        for step in range(1, 4):
            prepared.gateway.tick(prepared.now_ns + step * PERIOD_NS)
        again = prepared.tick(prepared.battery(0, 0))
        assert again._replace(snapshot=None) == healthy._replace(snapshot=None)
        for message in healthy.snapshot.messages:
            assert again.snapshot.latest(message.name) == healthy.snapshot.latest(message.name)


ACTIVE_ALONE = [
    pytest.param(mode, id=mode.name, marks=() if mode is Mode.ACTIVE else pytest.mark.ci)
    for mode in Mode
]


@pytest.mark.timeout(400)  # 65,536 words: a minute of a processor that others want too
@pytest.mark.parametrize("prepared", ACTIVE_ALONE, indirect=True)
def test_every_word_of_the_battery_has_its_effects_and_no_others(prepared):
    for byte6, byte7 in product(range(256), repeat=2):
        if prepared.mode != "ACTIVE" and (byte6 >> 4 & 3) != (byte6 + byte7 + byte7 // 4) % 4:
            continue
        effects = expected_effects("battery", ((6, byte6), (7, byte7)))
        prepared.check(effects, prepared.battery(byte6, byte7))


GOOD_BEFORE_AND_AFTER = ((0, 1), (1, 0), (1, 1))


@pytest.mark.ci
def test_every_word_has_its_effects_though_good_frames_come_in_the_same_tick(driving):
    for case, (byte6, byte7) in enumerate(product(range(256), repeat=2)):
        if (byte6 >> 4 & 3) != (byte6 + byte7 + byte7 // 4) % 4:
            continue
        before, after = GOOD_BEFORE_AND_AFTER[case % 3]
        words = [(0, 0)] * before + [(byte6, byte7)] + [(0, 0)] * after
        frames = [driving.battery(*word, number) for number, word in enumerate(words)]
        driving.check(expected_effects("battery", ((6, byte6), (7, byte7))), *frames)


@pytest.mark.parametrize("name", ["PCU1", "PCU2"])
@pytest.mark.parametrize(("before", "after"), GOOD_BEFORE_AND_AFTER)
def test_every_word_of_a_controller_counts_though_good_frames_come(driving, name, before, after):
    for byte4 in range(256):
        effects = expected_effects("controller", ((4, byte4),))
        words = (*[3] * before, byte4, *[3] * after)
        frames = [controller(name, word, throttle=51) for word in words]  # it obeys
        driving.check(effects, *frames)


@pytest.mark.parametrize("name", ["PCU1", "PCU2"])
def test_every_word_of_a_controller_has_its_effects_on_both(prepared, name):
    for byte4 in range(256):
        effects = expected_effects("controller", ((4, byte4),))
        prepared.check(effects, controller(name, byte4))


def test_every_pair_of_levels_of_the_controllers_has_the_effects_of_both(driving):
    levels = [voltage | protect << 5 for voltage, protect in product(range(8), range(4))]
    for first, second in product(levels, repeat=2):
        effects = expected_effects("controller", ((4, first),)) | expected_effects(
            "controller", ((4, second),)
        )
        driving.check(effects, controller("PCU1", first), controller("PCU2", second))


CAUSE_OF = {
    "ALARM": ("battery", 7, 0x40),
    "REGEN_LIMIT": ("battery", 6, 0x01),
    "REGEN_OFF": ("battery", 7, 0x10),
    "CUT": ("battery", 7, 0x80),
    "TURBO_OFF": ("PCU1", 4, 0x23),
    "STOP": ("PCU2", 4, 0x43),
    "POWER_LIMIT": ("battery", 6, 0x04),
}


def test_every_set_of_effects_gives_each_field_its_most_restrictive_value(driving):
    for size in range(len(CAUSE_OF) + 1):
        for effects in combinations(CAUSE_OF, size):
            values = {("battery", 6): 0, ("battery", 7): 0, ("PCU1", 4): 3, ("PCU2", 4): 3}
            for node, number, bits in (CAUSE_OF[effect] for effect in effects):
                values[node, number] |= bits
            driving.check(
                frozenset(effects),
                driving.battery(values["battery", 6], values["battery", 7]),
                controller("PCU1", values["PCU1", 4]),
                controller("PCU2", values["PCU2", 4]),
            )
