"""Program of the pedals: reads them at a fixed rate and demands what they say, until one fails."""

import threading
import time
from collections.abc import Callable, Mapping

from vcu_gateway.client import Client, ClientError, DemandValues, NoRightError, RefusedError
from vcu_gateway.errors import NotPermittedError, Problem, RequestRefusedError, UnavailableError
from vcu_gateway.pedals.configuration import PedalsConfig
from vcu_gateway.pedals.sources import PedalSource

TTL_MS = 200
BEYOND_PCT = 10.0
"""Travel beyond an end that tells an open or shorted wire (docs/safety.md, Pedals)."""
_BEYOND_FOR_S = 0.1
_HOLD_S = 0.1  # a read that hangs: the client demands no motion from then on
_SHOW_EVERY_S = 0.1
_BAR = 20
_REMEDIES = {
    "other_owner": "another program demands: end it, or see demand.priorities",
    "second_track_missing": "these pedals have one track, for a bench",
}

Say = Callable[[str], None]


def dead_zoned(travel_pct: float, dead_zone_pct: float) -> float:
    """Percent demanded: 0 and 100 within the dead zone of either end, linear between."""
    between = (travel_pct - dead_zone_pct) / (100 - 2 * dead_zone_pct)
    return 100 * min(1.0, max(0.0, between))


def is_beyond(travel_pct: float) -> bool:
    """Whether a wire is open or shorted, or the value is no number."""
    return not -BEYOND_PCT <= travel_pct <= 100 + BEYOND_PCT


def travels_pct(config: PedalsConfig, values: Mapping[str, float]) -> dict[str, float]:
    return {name: track.travel_pct(values[name]) for name, track in config.tracks().items()}


def demand_of(config: PedalsConfig, travels: Mapping[str, float]) -> DemandValues:
    """Demand at these travels: no throttle where one of them is beyond, the brake where known."""
    known = not any(map(is_beyond, travels.values()))

    def asked_pct(name: str, believed: bool) -> float:
        return dead_zoned(travels[name], config.dead_zone_pct) if believed else 0.0

    has_brake = "brake" in travels and not is_beyond(travels["brake"])
    values: DemandValues = {
        "throttle_pct": asked_pct("throttle", known),
        "brake_pct": asked_pct("brake", has_brake),
        "power_mode": config.power_mode,
        "regen_brake": config.regen_brake,
    }
    if "throttle_track2" in travels:
        values["throttle_track2_pct"] = asked_pct("throttle_track2", known)
    return values


class ReadWatch:
    """Judge of the reads: late ones in a row, and how long a track has been beyond its ends.

    Times are seconds of one monotonic clock.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._late_in_a_row = 0
        self._beyond_since_s: float | None = None

    def check(self, due_s: float, done_s: float, travels: Mapping[str, float]) -> None:
        """UnavailableError where the pedals must not be demanded any longer."""
        late_s = done_s - due_s
        self._late_in_a_row = self._late_in_a_row + 1 if late_s > self._period_s else 0
        if self._late_in_a_row > 1 or late_s * 1000 > TTL_MS:
            raise _failed(f"reads are late, the last one by {late_s * 1000:.0f} ms")
        beyond = [f"{name} at {pct:.0f} %" for name, pct in travels.items() if is_beyond(pct)]
        if not beyond:
            self._beyond_since_s = None
            return
        if self._beyond_since_s is None:
            self._beyond_since_s = done_s
        if done_s - self._beyond_since_s > _BEYOND_FOR_S:
            what = f"beyond its travel: {', '.join(beyond)}"
            raise _failed(what, "look for an open or shorted wire")


def run(
    config: PedalsConfig, source: PedalSource, client: Client, stop: threading.Event, say: Say
) -> None:
    """Demand what the pedals say until `stop`; released at the end, also by an error."""
    period_s, reached = 1 / config.rate_hz, True
    try:
        with client.demand(config.source, ttl_ms=TTL_MS, hold_s=_HOLD_S) as owner:
            say(f"demanding as {config.source} what {source.name} says")
            watch, due_s = ReadWatch(period_s), time.monotonic()
            while not stop.is_set():
                travels = travels_pct(config, _read(source))
                watch.check(due_s, time.monotonic(), travels)
                owner.set(**demand_of(config, travels))
                if owner.connected != reached:
                    reached = not reached
                    say("demanding again" if reached else "the gateway has gone; waiting for it")
                due_s = max(due_s + period_s, time.monotonic())
                stop.wait(due_s - time.monotonic())
    except NoRightError as error:
        remedy = "name this program's user in api.operator_users"
        raise NotPermittedError(Problem(f"the gateway: {error}", "", remedy)) from error
    except RefusedError as error:
        remedy = _REMEDIES.get(error.refusal, "")
        raise RequestRefusedError(Problem(f"refused: {error}", "", remedy)) from error
    except ClientError as error:
        raise UnavailableError(Problem(f"the gateway: {error}")) from error


def show(config: PedalsConfig, source: PedalSource, draw: Say, stop: threading.Event) -> None:
    """Draw each track's value, its least and most so far, and its travel; no demand is made."""
    seen: dict[str, tuple[float, float]] = {}
    while not stop.is_set():
        values = _read(source)
        for name, value in values.items():
            least, most = seen.get(name, (value, value))
            seen[name] = min(least, value), max(most, value)
        travels = travels_pct(config, values)
        draw("\n".join(line_of(name, values[name], seen[name], travels[name]) for name in travels))
        stop.wait(_SHOW_EVERY_S)


def line_of(name: str, value: float, seen: tuple[float, float], travel_pct: float) -> str:
    """One track in a line."""
    full = round(_BAR * min(100.0, max(0.0, travel_pct)) / 100)
    bar = "beyond its travel" if is_beyond(travel_pct) else "#" * full
    least, most = seen
    return (
        f"{name:<16}{value:10.4g}  [{bar:.<{_BAR}}] {travel_pct:z4.0f} %"
        f"  seen {least:.4g} to {most:.4g}"
    )


def _read(source: PedalSource) -> Mapping[str, float]:
    try:
        return source.read()
    except (OSError, ValueError) as error:
        raise _failed(f"{source.name} cannot be read: {error}", "is it there?") from error


def _failed(what: str, remedy: str = "") -> UnavailableError:
    return UnavailableError(Problem(f"the pedals end: {what}", "", remedy))
