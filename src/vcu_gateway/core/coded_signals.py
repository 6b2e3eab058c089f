"""Coded signals: effects of each code that battery and controllers report."""

from collections.abc import Iterator, Mapping

from vcu_gateway.core.causes import Effect, Finding
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.snapshot import LatestFrame, Snapshot

BATTERY_STATUS = "BMS_Status"
CONTROLLER_STATUS = tuple(f"{controller}_Status1" for controller in CONTROLLERS)

_ALARM, _STOP, _CUT = (Effect.ALARM,), (Effect.STOP,), (Effect.CUT,)
_LIMITS = (Effect.REGEN_LIMIT, Effect.POWER_LIMIT)
_NONE: tuple[Effect, ...] = ()

BATTERY_EFFECTS: Mapping[str, tuple[tuple[Effect, ...], ...]] = {
    "CellOvervoltage": (_NONE, (Effect.REGEN_LIMIT,), (Effect.REGEN_OFF,), (Effect.REGEN_OFF,)),
    "CellUndervoltage": (_NONE, (Effect.POWER_LIMIT,), _STOP, _CUT),
    "DischargeOvercurrent": (_NONE, _LIMITS, _CUT, _CUT),
    "TemperatureImbalance": (_NONE, _ALARM, _ALARM, _ALARM),
    "Overtemperature": (_NONE, _ALARM, _CUT, _CUT),
    "Undertemperature": (_NONE, (Effect.REGEN_OFF,), _CUT, _CUT),
    "VoltageImbalance": (_NONE, _ALARM),
    "InternalFault": (_NONE, _CUT),
}
"""Effects of each code of BMS_Status; a reserved code is the worst (docs/protocol.md E13)."""

UNTIL_RESTART = {("CellOvervoltage", 3)}

CONTROLLER_EFFECTS: Mapping[str, tuple[tuple[Effect, ...], ...]] = {
    "TemperatureProtectLevel": (_NONE, (Effect.TURBO_OFF,), _STOP, _STOP),
    "VoltageLevel": (
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
        (Effect.POWER_LIMIT,),
        _NONE,
        _NONE,
        _NONE,
        (Effect.REGEN_OFF,),
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
    ),
}
"""Effects of each code of a controller's Status1."""

_EFFECTS = {
    BATTERY_STATUS: BATTERY_EFFECTS,
    **dict.fromkeys(CONTROLLER_STATUS, CONTROLLER_EFFECTS),
}
_CODED = {message: tuple(effects) for message, effects in _EFFECTS.items()}


class CodedSignals:
    """Findings of coded signals, kept while the frame that they come from is the latest."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[LatestFrame, tuple[Finding, ...]]] = {}

    def findings(self, snapshot: Snapshot, message: str) -> tuple[Finding, ...]:
        """Finding of every code that has an effect, in the frames that are to be judged."""
        frames = snapshot.judged(message)
        if len(frames) != 1:
            return tuple(_found(snapshot, message))
        (frame,) = frames
        kept = self._kept.get(message)
        if kept is None or kept[0] is not frame:
            kept = self._kept[message] = frame, tuple(_found(snapshot, message))
        return kept[1]


def _found(snapshot: Snapshot, message: str) -> Iterator[Finding]:
    for codes in snapshot.codes(message, _CODED[message]):
        for (signal, effects), raw in zip(_EFFECTS[message].items(), codes, strict=True):
            name = snapshot.code_name(message, signal, raw)
            for effect in effects[raw]:
                yield Finding(
                    "code",
                    f"{message}.{signal}",
                    effect,
                    f"{raw} ({name or 'reserved'})",
                    until_restart=(signal, raw) in UNTIL_RESTART,
                )
