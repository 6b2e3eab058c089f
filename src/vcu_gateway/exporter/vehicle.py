"""Metrics of the vehicle: mode, causes, demand, commands, limits and received signals."""

from collections.abc import Callable, Mapping
from typing import get_args

from vcu_gateway.api import results
from vcu_gateway.exporter.family import (
    MS_PER_S,
    Family,
    GatewayAnswers,
    Samples,
    by,
    gauge,
    of_state,
    of_tuning,
    of_why,
    one,
    states,
)

_PCT = 100
_MODES = get_args(results.ModeName)
_FAULT_CLASSES = get_args(results.FaultClassName)
_EFFECTS = get_args(results.EffectName)
_STOP_STAGES = get_args(results.StopStageName)
_POWER_MODES = get_args(results.PowerModeName)


def _causes(why: results.Why) -> list[results.Cause]:
    return [*why["blocks"], *why["limits"], *why["alarms"]]


def _fault_latched(why: results.Why) -> Samples:
    latch = why["latch"]
    return states(_FAULT_CLASSES, [latch["fault_class"]] if latch else [])


def _cause_seconds(why: results.Why) -> Samples:
    return {
        (cause["cause"], cause["subject"], cause["effect"]): cause["since_ms"] / MS_PER_S
        for cause in _causes(why)
    }


def _demand_age(why: results.Why) -> Samples:
    demand = why["demand"]
    age_ms = None if demand is None else demand["age_ms"]
    return one(None if age_ms is None else age_ms / MS_PER_S)


def _demand(name: str, text: str, value: Callable[[results.DemandedValues], float]) -> Family:
    return gauge(
        f"demand_{name}",
        f"{text} that the demand asks for, 0 to 1; absent where none counted.",
        of_state(lambda state: by({n: value(asked) for n, asked in state["demanded"].items()})),
        "controller",
    )


def _decided(state: results.State) -> Mapping[str, results.ControllerCommand]:
    return {name: one for name, one in state["commands"].items() if one["decided"] is not None}


def _command(name: str, text: str, value: Callable[[results.ControllerCommand], float]) -> Family:
    return gauge(
        f"command_{name}",
        f"{text} in the last tick; absent while listening.",
        of_state(lambda state: by({n: value(one) for n, one in _decided(state).items()})),
        "controller",
    )


def _power_modes(state: results.State) -> Samples:
    return {
        (controller, mode): float(one["power_mode"] == mode)
        for controller, one in _decided(state).items()
        for mode in _POWER_MODES
    }


def _stop_stage(state: results.State) -> Samples:
    stop = state["stop"]
    return states(_STOP_STAGES, [stop["stage"]] if stop else [])


def _stop_obeyed(state: results.State) -> Samples:
    stop = state["stop"]
    return by({name: one["obeyed"] for name, one in stop["controllers"].items()} if stop else {})


def _limit(name: str, text: str, key: str, divisor: float = 1) -> Family:
    def read(reading: GatewayAnswers) -> Samples:
        config = reading.config
        return one(None if config is None else config["values"]["limits"][key] / divisor)

    return gauge(f"limit_{name}", text, read)


def _signals(state: results.State) -> Samples:
    return {
        (message, name, signal["unit"]): signal["value"]
        for message, received in state["messages"].items()
        for name, signal in received["signals"].items()
        if signal["quality"] == "good" and signal["value"] is not None
    }


def _drive_mode(tuning: results.TuningNow) -> Samples:
    mode = tuning["drive_mode"]
    return {} if mode is None else states(mode["modes"], [mode["current"]])


def _drive_mode_waits(tuning: results.TuningNow) -> Samples:
    mode = tuning["drive_mode"]
    if mode is None:
        return {}
    waits = mode["requested"] != mode["current"]
    return states(mode["modes"], [mode["requested"]] if waits else [])


def _curve_caps(tuning: results.TuningNow) -> Samples:
    return {
        (one["key"], one["cap_unit"]): one["cap"]
        for one in tuning["curves"]
        if one["cap"] is not None
    }


FAMILIES: tuple[Family, ...] = (
    gauge(
        "mode",
        "1 for the mode of the last tick, 0 for the others.",
        of_why(lambda why: states(_MODES, [why["mode"]])),
        "mode",
    ),
    gauge(
        "fault_latched",
        "1 where a fault is latched, by the level of the reset that it needs.",
        of_why(_fault_latched),
        "fault_class",
    ),
    gauge(
        "stop_stage",
        "1 for how far a latched stop has come, 0 for the others; all are 0 where none is latched.",
        of_state(_stop_stage),
        "stage",
    ),
    gauge(
        "stop_obeyed",
        "1 where a controller's own status says that it has cut, 0 where it says otherwise;"
        " absent where that is not known or no stop is latched.",
        of_state(_stop_obeyed),
        "controller",
    ),
    gauge(
        "effect",
        "1 for each effect that counted in the last tick, 0 for the others.",
        of_why(lambda why: states(_EFFECTS, [cause["effect"] for cause in _causes(why)])),
        "effect",
    ),
    gauge(
        "cause_seconds",
        "How long each cause with its effect has counted; absent where it does not count.",
        of_why(_cause_seconds),
        "cause",
        "subject",
        "effect",
    ),
    gauge(
        "demand_fresh",
        "1 where a demand counted in the last tick, else 0.",
        of_why(lambda why: one(float(bool(why["demand"] and why["demand"]["fresh"])))),
    ),
    gauge(
        "demand_age_seconds",
        "Age of the latest demand; absent without one and for the bench demand.",
        of_why(_demand_age),
    ),
    _demand("throttle_ratio", "Throttle", lambda asked: asked["throttle_pct"] / _PCT),
    _demand("brake_ratio", "Brake", lambda asked: asked["brake_pct"] / _PCT),
    _command(
        "throttle_ratio", "Commanded throttle, 0 to 1,", lambda sent: sent["throttle_pct"] / _PCT
    ),
    _command("brake_ratio", "Commanded brake, 0 to 1,", lambda sent: sent["brake_pct"] / _PCT),
    _command("speed_limit_rpm", "Commanded speed limit", lambda sent: sent["speed_limit_rpm"]),
    _command("power_limit_watts", "Commanded power limit", lambda sent: sent["power_limit_w"]),
    _command("motor_reverse", "1 where reverse was commanded", lambda sent: sent["motor_reverse"]),
    _command("regen_brake", "1 where regeneration was commanded", lambda sent: sent["regen_brake"]),
    _command("power_cut", "1 where POWER_CUT was commanded", lambda sent: sent["power_cut"]),
    gauge(
        "command_power_mode",
        "1 for the power mode commanded in the last tick; absent while listening.",
        of_state(_power_modes),
        "controller",
        "power_mode",
    ),
    _limit("speed_rpm", "Configured maximum of the speed limit.", "speed_limit_max_rpm"),
    _limit("power_watts", "Configured maximum of the power limit.", "power_limit_max_w"),
    _limit(
        "derated_power_watts",
        "Configured power limit under the effect `power limit`.",
        "derated_power_w",
    ),
    _limit(
        "regen_ratio",
        "Configured brake under the effect `regen limit`, 0 to 1.",
        "regen_limit_pct",
        _PCT,
    ),
    gauge(
        "drive_mode",
        "1 for the drive mode whose pedal map counts, 0 for the others; absent where there are"
        " none.",
        of_tuning(_drive_mode),
        "mode",
    ),
    gauge(
        "drive_mode_waits",
        "1 for the drive mode that was asked for and waits for the pedal's release, 0 for the"
        " others; absent where there are none.",
        of_tuning(_drive_mode_waits),
        "mode",
    ),
    gauge(
        "curve_cap",
        "Limit that each curve gives now, in its unit; absent where it gives none.",
        of_tuning(_curve_caps),
        "curve",
        "unit",
    ),
    gauge(
        "curve_input_known",
        "1 where the input of each curve is known, 0 where a message is stale or a signal out of"
        " range; absent where there are no curves.",
        of_tuning(lambda now: by({one["key"]: one["x"] is not None for one in now["curves"]})),
        "curve",
    ),
    gauge(
        "signal",
        "Received signals in the protocol's units, codes as numbers;"
        " absent unless fresh and in range.",
        of_state(_signals),
        "message",
        "signal",
        "unit",
    ),
)
