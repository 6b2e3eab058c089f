"""Arrivals: what every frame since the last tick said, and what its order says."""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple, Protocol

from vcu_gateway.judge import wire
from vcu_gateway.judge.limits import VerdictLimits
from vcu_gateway.judge.wire import CONTROLLERS, LENGTH, MS, PERCENT_PER_BIT, REVERSE

_SENT_FRAMES = 80
_THROTTLE_WINDOW_NS = 1_000 * MS
_DIRECTION_WINDOW_NS = 1_100 * MS
_ABOVE_MAX_PCT = 5.0
_STEP_WITHIN_NS = 100 * MS
_PLAUSIBLE_FRAMES = 3
_LIFE = 0x80
_NEVER = -(1 << 63)
_FUTURE_NS = 20 * MS
_PRIORITY_BIT = 26
_STATUS1 = tuple(f"{name}_Status1" for name in CONTROLLERS)
_STATUS2 = tuple(f"{name}_Status2" for name in CONTROLLERS)
_FOR_TUNING = ("ARD2_SteeringWheel", "BMS_Temperatures")
_JUDGED = frozenset({"BMS_Status", *_STATUS1, *_STATUS2, *_FOR_TUNING})


class BusFrame(Protocol):
    """Frame as a recording has it."""

    can_id: int
    data: bytes | bytearray
    arrival_ns: int
    extended: bool
    remote: bool
    error: bool
    own_echo: bool


class Arrived(NamedTuple):
    """Payload of a frame and its arrival stamp."""

    data: bytes
    at_ns: int


class LeftCommand(NamedTuple):
    """Throttle code and direction of a command that left."""

    at_ns: int
    throttle_raw: int
    reverse: bool


class Deviations:
    """Runs of frames of one kind that are not as they should be.

    Attributes:
        run: of the latest frames in a row.
    """

    def __init__(self) -> None:
        self.run = 0
        self._at_ns = 0
        self._seen: tuple[int, int] | None = None

    def note(self, odd: bool, at_ns: int, *, latest: bool = True) -> None:
        """Take in the next frame; one out of order begins no new run."""
        run = self.run + 1 if odd else 0
        self._see(run, at_ns)
        if latest:
            self.run, self._at_ns = run, at_ns
        else:
            self._see(self.run, self._at_ns)

    def _see(self, run: int, at_ns: int) -> None:
        if self._seen is None or run > self._seen[0]:
            self._seen = (run, at_ns)

    @property
    def worst(self) -> tuple[int, int]:
        """Longest run since the last tick and the stamp of its frame; without one, what stands."""
        return (self.run, self._at_ns) if self._seen is None else self._seen

    def end_tick(self) -> None:
        """The next tick judges what comes from now on, and the run that stands."""
        self._seen = None


def _is_whole(frame: BusFrame) -> bool:
    return len(frame.data) == LENGTH and not frame.remote


class Arrivals:
    """Memory of the bus: latest frames, frames since the last tick, and deviations.

    Attributes:
        latest: newest frame of each message whose signals are judged.
        latest_ns: stamp of the newest frame of every message.
        since_tick: every frame of each message since the last tick.
        sent: commands that left lately, by controller, oldest first.
        echoed_ns: stamps of our own commands that came back since the last tick.
        foreign_ns: stamp of the first command of another sender since the last tick.
        life: frames in a row with an unchanged LifeSignal.
        above, below, turned: echoes in a row with more throttle than was commanded, with too
            little, with another direction.
        doubted: frames until a motor's speed is believed again; speed_unknown: it was not
            believed at some time since the last tick.
    """

    def __init__(self, limits: VerdictLimits, *, complete: bool) -> None:
        self.limits = limits
        self._complete = complete
        self._first_sent_ns: int | None = None
        self.latest: dict[str, Arrived] = {}
        self.since_tick: dict[str, list[Arrived]] = {}
        self.sent: dict[str, deque[LeftCommand]] = {
            name: deque(maxlen=_SENT_FRAMES) for name in CONTROLLERS
        }
        self.echoed_ns: dict[str, int] = {}
        self.foreign_ns: int | None = None
        self.life = Deviations()
        self.below = {name: Deviations() for name in CONTROLLERS}
        self.turned = {name: Deviations() for name in CONTROLLERS}
        self.above = {name: Deviations() for name in CONTROLLERS}
        self.doubted = dict.fromkeys(CONTROLLERS, 0)
        self.speed_unknown: set[str] = set()
        names = wire.messages(limits.aliases)
        self._names = {key: name for key, name in names.items() if name in _JUDGED}
        # Of the others only the time counts; by each identifier, whatever its priority.
        self._plain = {
            key | priority << _PRIORITY_BIT: name
            for key, name in names.items()
            if name not in _JUDGED
            for priority in range(8)
        }
        self.latest_ns: dict[str, int] = dict.fromkeys(self._plain.values(), _NEVER)

    def receive(self, frames: Iterable[BusFrame]) -> list[BusFrame]:
        """Take in frames; error frames and our own that came back are handed back."""
        handed_back, plain, latest_ns = [], self._plain, self.latest_ns
        for frame in frames:
            name = plain.get(frame.can_id)
            if name is None or frame.error or not frame.extended:
                if frame.error or self._take(frame):
                    handed_back.append(frame)
            elif frame.arrival_ns > latest_ns[name] and _is_whole(frame):
                latest_ns[name] = frame.arrival_ns
        return handed_back

    def _take(self, frame: BusFrame) -> bool:
        """Take in a frame whose signals are judged, or a command; True for our own."""
        if not frame.extended:
            return False
        name = self._names.get(frame.can_id & wire.MATCH)
        if name is not None:
            if _is_whole(frame):
                self._keep(name, Arrived(bytes(frame.data), frame.arrival_ns))
            return False
        controller = wire.controller_commanded(frame.can_id)
        if frame.own_echo:
            if controller is not None and len(frame.data) == LENGTH:
                self.echoed_ns[controller] = frame.arrival_ns
            return True
        if wire.commands_somebody(frame.can_id) and self.foreign_ns is None:
            self.foreign_ns = frame.arrival_ns
        return False

    def _keep(self, name: str, frame: Arrived) -> None:
        before = self.latest.get(name)
        since_tick = self.since_tick.get(name)
        if since_tick is None:
            self.since_tick[name] = [frame]
        else:
            since_tick.append(frame)
        in_order = before is None or frame.at_ns >= before.at_ns
        if name in _STATUS1:
            self._hold_echo_against_commands(name[:4], frame, in_order)
        if not in_order:
            return
        self.latest[name] = frame
        self.latest_ns[name] = frame.at_ns
        if before is None:
            return
        if name == "BMS_Status":
            self.life.note(not (before.data[7] ^ frame.data[7]) & _LIFE, frame.at_ns)
        elif name in _STATUS2:
            self._hold_speed_against_the_last(name[:4], before, frame)

    def _hold_echo_against_commands(self, name: str, frame: Arrived, latest: bool) -> None:
        at_ns, echoed = frame.at_ns, frame.data[1]
        if not self._knows_what_was_sent(at_ns):
            return
        sent = [one for one in self.sent[name] if one.at_ns <= at_ns]
        second = [one for one in sent if at_ns - one.at_ns <= _THROTTLE_WINDOW_NS]
        raws = [one.throttle_raw for one in second]
        whole = bool(sent) and at_ns - self.sent[name][0].at_ns >= _THROTTLE_WINDOW_NS
        lack_pct = (min(raws, default=0) - echoed) * PERCENT_PER_BIT
        low = whole and bool(raws) and lack_pct > self.limits.echo_below_max_pct
        self.below[name].note(low, at_ns, latest=latest)
        told = {one.reverse for one in sent if at_ns - one.at_ns <= _DIRECTION_WINDOW_NS}
        odd = bool(told) and bool(frame.data[0] & REVERSE) not in told
        self.turned[name].note(odd, at_ns, latest=latest)
        excess_pct = (echoed - max(raws, default=0)) * PERCENT_PER_BIT - _ABOVE_MAX_PCT
        self.above[name].note(excess_pct > 1e-6, at_ns, latest=latest)

    def _knows_what_was_sent(self, at_ns: int) -> bool:
        """False for a while where the recording begins in the middle."""
        first_ns = self._first_sent_ns
        return self._complete or (first_ns is not None and at_ns - first_ns > _DIRECTION_WINDOW_NS)

    def _hold_speed_against_the_last(self, name: str, before: Arrived, frame: Arrived) -> None:
        step_rpm = abs(wire.speed_rpm(frame.data) - wire.speed_rpm(before.data))
        near = frame.at_ns - before.at_ns <= _STEP_WITHIN_NS
        if near and step_rpm > self.limits.motor_speed_step_max_rpm:
            self.doubted[name] = _PLAUSIBLE_FRAMES
        elif self.doubted[name]:
            self.doubted[name] -= 1
        if self.doubted[name]:
            self.speed_unknown.add(name)

    def judged(self, name: str) -> list[Arrived]:
        """Every frame of a message since the last tick; where none came, the latest."""
        last = self.latest.get(name)
        return self.since_tick.get(name) or ([] if last is None else [last])

    def came(self, name: str) -> bool:
        return self.latest_ns.get(name, _NEVER) != _NEVER

    def age_ns(self, name: str, now_ns: int) -> int | None:
        """Age of the newest frame; None where none came, or it is stamped in the future."""
        age_ns = now_ns - self.latest_ns.get(name, _NEVER)
        return age_ns if self.came(name) and age_ns >= -_FUTURE_NS else None

    def stale(self, name: str, now_ns: int) -> bool:
        """True where a message is too old, never came, or is stamped in the future."""
        age_ns = self.age_ns(name, now_ns)
        return age_ns is None or age_ns > self.limits.stale_ns[name]

    def speeds_rpm(self, now_ns: int) -> list[int] | None:
        """Every speed of both motors that this tick knows; None where one is not known."""
        if self.speed_unknown or any(self.stale(name, now_ns) for name in _STATUS2):
            return None
        if any(self.doubted[name[:4]] and name not in self.since_tick for name in _STATUS2):
            return None
        return [wire.speed_rpm(frame.data) for name in _STATUS2 for frame in self.judged(name)]

    @property
    def speeds_came(self) -> bool:
        return all(map(self.came, _STATUS2))

    def is_doubted(self, controller: str) -> bool:
        """The motor's speed was not believed at some time since the last tick."""
        return controller in self.speed_unknown or bool(self.doubted[controller])

    def note_sent(self, controller: str, data: bytes, at_ns: int) -> None:
        if self._first_sent_ns is None:
            self._first_sent_ns = at_ns
        self.sent[controller].append(LeftCommand(at_ns, data[1], bool(data[0] & REVERSE)))

    def end_tick(self) -> None:
        self.since_tick.clear()
        self.echoed_ns.clear()
        self.foreign_ns = None
        self.speed_unknown.clear()
        echoes = (*self.above.values(), *self.below.values(), *self.turned.values())
        for deviations in (self.life, *echoes):
            deviations.end_tick()
