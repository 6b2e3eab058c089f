"""Methods of the API: name, model of the parameters, result and the right needed.

A new method is one entry in `METHODS` and its handler in `server/queries.py` or
`server/dispatch.py`; the OpenRPC document, docs/api.md and the tests follow.
"""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from vcu_gateway.api import results
from vcu_gateway.api.errors import Right
from vcu_gateway.demand_ranges import span

MAX_RATE_HZ = 50.0


class Params(BaseModel):
    """Base of the parameters: no unknown names, no coercion, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Nothing(Params):
    """No parameters."""


class StateParams(Params):
    """Names of the messages to report."""

    messages: Annotated[list[str], Field(max_length=64)] | None = Field(
        default=None, description="Message names; null is all of them."
    )


class SubscribeParams(StateParams):
    """Names of the messages to report, and the rate of the updates."""

    rate_hz: float = Field(
        default=10.0, ge=0.1, le=MAX_RATE_HZ, description="Updates a second, 0.1 to 50."
    )


class UnsubscribeParams(Params):
    """Number of the subscription to end."""

    subscription: int


class ControllerParams(Params):
    """Demand for one controller; what is left out is at its default.

    The ranges are checked where the demand is taken, which answers with the reason.
    """

    throttle_pct: float = Field(default=0.0, description=f"{span('throttle_pct')} %.")
    throttle_track2_pct: float | None = Field(
        default=None,
        description=f"The pedal's second track, {span('throttle_track2_pct')} %; null where there"
        " is none. A difference of more than 10 % for more than 100 ms takes the throttle away.",
    )
    brake_pct: float = Field(default=0.0, description=f"{span('brake_pct')} %.")
    power_mode: results.PowerModeName = "eco"
    motor_reverse: bool = False
    regen_brake: bool = False
    speed_limit_rpm: float | None = Field(
        default=None,
        description=f"{span('speed_limit_rpm')} rpm; null is the configured maximum.",
    )
    power_limit_w: float | None = Field(
        default=None,
        description=f"{span('power_limit_w')} W; null is the highest: whatever the configured"
        " maximum and its ramp allow.",
    )


SourceName = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.:-]+$")]


class DemandParams(Params):
    """A demand: `values` for both controllers, or `controllers` with one for each."""

    source: SourceName = Field(
        description="Name of the sender. It belongs to one connection at a time."
    )
    sequence: int = Field(
        ge=0,
        lt=2**63,
        description="Rises with every demand of a source; an old one is refused,"
        " also after another source had the demand.",
    )
    ttl_ms: int | None = Field(
        default=None,
        description="How long it counts, from made_ns on; null is demand.ttl_default_ms.",
    )
    made_ns: int | None = Field(
        default=None,
        ge=0,
        lt=2**63,
        description="When it was made, CLOCK_MONOTONIC of this machine, so that time spent in"
        " buffers counts; null is when the gateway read it.",
    )
    values: ControllerParams | None = None
    controllers: dict[results.ControllerName, ControllerParams] | None = None


class ReleaseParams(Params):
    """Source whose demand ends."""

    source: SourceName


class ResetParams(Params):
    """Level of the reset."""

    level: results.FaultClassName = "driver"


class DriveModeParams(ResetParams):
    """Drive mode to be taken, and the level at which it is asked for."""

    mode: str = Field(max_length=64, description="Name of a configured drive mode.")


class EventsParams(Params):
    """Number of events to report."""

    limit: int = Field(default=50, ge=1, le=200, description="Number of events, the latest ones.")


class Method(NamedTuple):
    """One method.

    Attributes:
        params: model of the parameters, by name; result: type of the result.
        right: what the peer needs; at service level it is SERVICE instead.
    """

    params: type[Params]
    result: type
    right: Right
    summary: str


METHODS: Mapping[str, Method] = {
    "state.get": Method(
        StateParams,
        results.State,
        Right.READ,
        "Received signals, commands, and what is known of a stop.",
    ),
    "state.subscribe": Method(
        SubscribeParams,
        results.Subscribed,
        Right.READ,
        "The state again and again, as `state.update` notifications. A slow reader loses updates.",
    ),
    "state.unsubscribe": Method(
        UnsubscribeParams, results.Subscribed, Right.READ, "End a subscription."
    ),
    "demand.set": Method(
        DemandParams,
        results.Granted,
        Right.OPERATE,
        "Ask for throttle, brake and so on. The demand ends with its time to live, and with the"
        " connection that made it.",
    ),
    "demand.release": Method(
        ReleaseParams, results.Granted, Right.OPERATE, "End one's own demand at once."
    ),
    "arm": Method(
        Nothing,
        results.Granted,
        Right.OPERATE,
        "From standby to active, once nothing but a throttle of 0 was demanded for 200 ms.",
    ),
    "disarm": Method(
        Nothing,
        results.Granted,
        Right.READ,
        "From active to standby. Everybody who reaches the socket may stop it.",
    ),
    "reset": Method(
        ResetParams, results.Granted, Right.OPERATE, "From fault to starting, at a level."
    ),
    "drive_mode.set": Method(
        DriveModeParams,
        results.Granted,
        Right.OPERATE,
        "Ask for a drive mode, which waits for the pedal's release where it would make a step. A"
        " mode with left_by_service is left at service level only.",
    ),
    "tuning.get": Method(
        Nothing,
        results.TuningNow,
        Right.READ,
        "Drive mode, where the vehicle is on each curve, and what the pedals on CAN say.",
    ),
    "estop": Method(
        Nothing,
        results.Granted,
        Right.READ,
        "Cut the power of both controllers; ends with a reset at service level.",
    ),
    "why": Method(Nothing, results.Why, Right.READ, "What blocks, what limits, what to do next."),
    "health": Method(
        Nothing, results.Health, Right.READ, "Bus, ticks, counters, versions, configuration."
    ),
    "events": Method(EventsParams, results.Events, Right.READ, "The latest events, counted."),
    "config.get": Method(
        Nothing, results.ConfigInEffect, Right.READ, "The configuration in effect."
    ),
    "config.reload": Method(
        Nothing,
        results.Reloaded,
        Right.SERVICE,
        "Read the configuration file again, all of it or nothing.",
    ),
    "protocol.get": Method(Nothing, results.Protocol, Right.READ, "Messages and signals."),
}

LEVEL_RIGHTS: Mapping[str, Right] = {"driver": Right.OPERATE, "service": Right.SERVICE}
"""Right that a request with a level needs, by that level."""
