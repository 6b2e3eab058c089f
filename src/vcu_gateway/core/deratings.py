"""Deratings: curves over slow inputs limit the fields that have ramps.

They fall at once and return slowly (docs/safety.md, Tuning). The limits of drive modes return in
the same way.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, get_args

from vcu_gateway.core.caps import FULL_PCT, NO_CAPS, Caps, of_effects
from vcu_gateway.core.causes import Effect, Finding
from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.law_inputs import InputReader, LawInputs
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.tuning import DERATINGS, Derating, Limit

_MOTOR_TEMPERATURE = "motor_temperature_c"
_MOTORS_APART_MAX_C = 40.0
_NO_LIMIT = math.inf
_OF_MODES: Mapping[Limit, str] = {limit: f"drive_modes.{limit}" for limit in get_args(Limit)}


class CurveState(NamedTuple):
    """A curve in the last tick.

    Attributes:
        x: its input; None where that is not known.
        cap: the limit that it gives, in the unit of the curve; None before the first tick.
    """

    name: str
    x: float | None
    cap: float | None


class _CurveNow:
    """A configured curve, and what it gave last: made again after a reload or a restart.

    Attributes:
        x: the worst value of its input; None where that is not known.
        target: the limit at x; None without one.
        finding: what there is to tell of it; None where it does not limit.
    """

    __slots__ = (
        *("curve", "derating", "end", "finding", "full", "key", "limit", "name"),
        *("target", "x"),
    )

    def __init__(self, curve: Curve, derating: Derating) -> None:
        self.curve, self.derating = curve, derating
        self.name, self.key, self.limit = derating.name, derating.key, derating.limit
        self.full = curve.highest
        self.end = 0 if derating.rises else 1  # of the span, that counts
        self.x: float | None = None
        self.target: float | None = None
        self.finding: Finding | None = None

    def look(self, span: tuple[float, float] | None) -> None:
        """Find the target in this span of its input."""
        self.x = None if span is None else span[self.end]
        self.target = None if self.x is None else self.curve.at(self.x)

    def told_of(self, cap: float) -> Finding | None:
        """What there is to tell where it gives this cap; None where it does not limit."""
        if self.x is not None and cap >= self.full:
            return None
        quantity = self.derating.input.quantity
        value = "not known" if self.x is None else f"{self.x:.4g} {quantity.unit}"
        detail = f"{value}: {_at_most(self.limit, cap)}"
        return Finding(self.key, quantity.text, Effect.CAP, detail)


class Deratings:
    """Limits of fields that have ramps: they fall at once and return slowly.

    Most ticks change nothing: limits are found anew only where a curve's target has changed or a
    limit is on the way back.

    Attributes:
        held: each limit as it is now, by a curve's name or that of a drive mode's limit.
    """

    def __init__(self) -> None:
        self.held: dict[str, float] = {}
        self._configured: Mapping[str, Curve] | None = None
        self._readers: dict[str, InputReader] = {}
        self._reading: dict[str, list[InputReader]] = {}
        self._said: dict[str, Decoded | None] = {}
        self._curves: dict[str, _CurveNow] = {}
        self._over: dict[InputReader, list[_CurveNow]] = {}
        self._of_modes: Mapping[Limit, float] = {}
        self._on_the_way = False
        self._result: tuple[Caps, Sequence[Finding], bool] = NO_CAPS, (), False

    @property
    def worst(self) -> dict[str, float | None]:
        """Each curve's input in the last tick; None where it was not known. From any thread."""
        return {name: one.x for name, one in self._curves.items()}

    def tick(
        self, inputs: LawInputs, of_modes: Mapping[Limit, float]
    ) -> tuple[Caps, Sequence[Finding]]:
        """Caps of every curve and of the drive modes, which return in the same way.

        A finding of each curve that limits or whose input is not known.
        """
        curves = inputs.settings.tuning.curves
        moved = self._on_the_way or of_modes is not self._of_modes
        if curves is not self._configured:
            self._begin(curves, inputs.snapshot)
            moved = True
        if changed := inputs.snapshot.changed(self._said):
            moved = self._read(changed, inputs.snapshot) or moved
        if moved or inputs.told is not self._result[2]:
            self._find(inputs, of_modes)
        return self._result[:2]

    def _read(self, changed: Iterable[str], snapshot: Snapshot) -> bool:
        """Read the inputs of these messages; True where a limit or what is told may change."""
        readers: dict[InputReader, None] = {}  # in an order that is always the same
        for message in changed:  # in most ticks: a comprehension is a call more
            for reader in self._reading[message]:
                readers[reader] = None
        moved = False
        for reader in readers:
            if reader.read(snapshot):
                moved = self._look(reader) or moved
        return moved

    def _look(self, reader: InputReader) -> bool:
        """Have the curves over an input find their targets; True where one changes anything."""
        moved = reader is self._readers.get(_MOTOR_TEMPERATURE)  # its difference is told, too
        for one in self._over[reader]:
            one.look(reader.span)
            moved = moved or self._changes(one)
        return moved

    def _changes(self, one: _CurveNow) -> bool:
        """True where its limit, or what there is to tell of it, may not be that of before."""
        if one.target is None or one.finding is not None:
            return True
        return one.target != self.held.get(one.name)

    def _find(self, inputs: LawInputs, of_modes: Mapping[Limit, float]) -> None:
        self._of_modes, self._on_the_way = of_modes, False
        for name, one in self._curves.items():
            if self._changes(one):
                self._hold(name, one.limit, one.target, inputs)
                one.finding = one.told_of(self.held[name])
        for limit, target in of_modes.items():
            if self.held.get(_OF_MODES[limit]) != target:
                self._hold(_OF_MODES[limit], limit, target, inputs)
        self._result = self._lowest(of_modes), self._findings(inputs.told), inputs.told

    def _begin(self, curves: Mapping[str, Curve], snapshot: Snapshot) -> None:
        """Curves that a reload took away are forgotten: one that comes again begins anew."""
        self._configured, self._readers = curves, {}
        self.held = {
            name: held
            for name, held in self.held.items()
            if name in curves or name not in DERATINGS
        }
        self._curves, self._over = {}, {}
        for name, curve in curves.items():
            derating = DERATINGS[name]
            key = derating.input.quantity.key
            reader = self._readers.setdefault(key, InputReader(derating.input, snapshot))
            one = self._curves[name] = _CurveNow(curve, derating)
            self._over.setdefault(reader, []).append(one)
        self._reading = {}
        for reader in self._readers.values():
            for message in reader.messages:
                self._reading.setdefault(message, []).append(reader)
        self._said = dict.fromkeys(self._reading)

    def _lowest(self, of_modes: Mapping[Limit, float]) -> Caps:
        lowest = {limit: self.held[_OF_MODES[limit]] for limit in of_modes}
        for name, one in self._curves.items():
            limit, held = one.limit, self.held[name]
            if held < lowest.get(limit, _NO_LIMIT):
                lowest[limit] = held
        return Caps(
            brake_pct=lowest.get("brake_pct", FULL_PCT),
            power_w=lowest.get("power_limit_w", _NO_LIMIT),
            speed_rpm=lowest.get("speed_limit_rpm", _NO_LIMIT),
        )

    def _findings(self, told: bool) -> Sequence[Finding]:
        found = [one.finding for one in self._curves.values() if told and one.finding is not None]
        return [*found, *self._differences()]

    def _differences(self) -> Sequence[Finding]:
        """Motors whose temperatures differ: one of two thermometers may be broken."""
        reader = self._readers.get(_MOTOR_TEMPERATURE)
        span = None if reader is None else reader.span
        if span is None or span[1] - span[0] <= _MOTORS_APART_MAX_C:
            return ()
        detail = f"differ by {span[1] - span[0]:.0f} °C"
        cause, subject = "motor_temperature_difference", "motor temperatures"
        return [Finding(cause, subject, Effect.ALARM, detail)]

    def _hold(self, name: str, limit: Limit, target: float | None, inputs: LawInputs) -> None:
        """Remember the limit now: at most the target, and in ACTIVE at most on its way back to it.

        Without a target, where the input is not known, it is at most what it was, in every mode.
        """
        held, settings = self.held.get(name, _NO_LIMIT), inputs.settings
        if target is None:
            held = min(held, _fallback(limit, settings))
        elif not inputs.active:
            held = target
        else:
            held = min(target, held + _return_per_s(limit, settings) * inputs.elapsed_s)
        self.held[name] = held
        self._on_the_way = self._on_the_way or held != target


def _fallback(limit: Limit, settings: Settings) -> float:
    """The limit where its input is not known."""
    caps = of_effects({Effect.POWER_LIMIT, Effect.REGEN_LIMIT}, settings)
    if limit == "power_limit_w":
        return caps.power_w
    return caps.brake_pct if limit == "brake_pct" else _NO_LIMIT


def _return_per_s(limit: Limit, settings: Settings) -> float:
    if limit == "power_limit_w":
        return settings.power_return_w_per_s
    if limit == "brake_pct":
        return settings.brake_return_pct_per_s
    return settings.speed_return_rpm_per_s


def _at_most(limit: Limit, cap: float) -> str:
    if limit == "power_limit_w":
        return f"power at most {cap / 1000:.1f} kW"
    if limit == "brake_pct":
        return f"brake at most {cap:.0f} %"
    return "speed not limited" if cap == _NO_LIMIT else f"speed at most {cap:.0f} rpm"
