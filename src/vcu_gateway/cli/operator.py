"""Verbs of an operator: what the running gateway is asked, and told."""

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

from vcu_gateway.api import results
from vcu_gateway.cli.options import json_option, level_option, socket_option
from vcu_gateway.client import (
    ApiError,
    Client,
    ClientError,
    ConfigRefusedError,
    NoRightError,
    UnreachableError,
)
from vcu_gateway.errors import (
    ConfigError,
    NotPermittedError,
    Problem,
    RequestRefusedError,
    UnavailableError,
)
from vcu_gateway.text import duration, table


def api_options(command: Callable[..., Any]) -> Callable[..., Any]:
    return socket_option(json_option(command))


@contextlib.contextmanager
def connected(socket_path: Path | None) -> Iterator[Client]:
    """Client whose errors become a line on stderr and an exit code."""
    try:
        with Client(socket_path) as client:
            yield client
    except ConfigRefusedError as error:
        raise ConfigError(*map(Problem, error.problems or (error.sentence,))) from error
    except NoRightError as error:
        raise NotPermittedError(Problem(error.sentence)) from error
    except ApiError as error:
        raise RequestRefusedError(Problem(error.sentence)) from error
    except UnreachableError as error:
        forbidden = isinstance(error.__cause__, PermissionError)
        raise (NotPermittedError if forbidden else UnavailableError)(Problem(str(error))) from error
    except ClientError as error:
        raise RequestRefusedError(Problem(str(error))) from error


def show(result: Any, as_json: bool, text: Callable[[], str]) -> None:
    click.echo(json.dumps(result, ensure_ascii=False) if as_json else text())


@click.command("status")
@api_options
@click.option("--check", is_flag=True, help="Exit with 1 unless the mode is standby or active.")
def status(socket_path: Path | None, as_json: bool, check: bool) -> None:
    """Print mode, reasons, demand, bus, ticks and commands of the running gateway."""
    with connected(socket_path) as client:
        why, health, state = client.why(), client.health(), client.state(())
    stop = state.get("stop")  # an older gateway does not tell it
    summary = {"why": why, "health": health, "commands": state["commands"], "stop": stop}
    show(summary, as_json, lambda: "\n".join(_lines(why, health, state)))
    if check and why["mode"] not in ("standby", "active"):
        sys.exit(1)


def _lines(why: results.Why, health: results.Health, state: results.State) -> list[str]:
    commands, stop = state["commands"].items(), state.get("stop")
    facts = {
        "mode": why["mode"],
        **({"now": why["summary"]} if "summary" in why else {}),
        **({} if stop is None else {"stop": stop["sentence"]}),
        "why": why["sentence"],
        "demand": _demand(why["demand"]),
        **{str(name): _command(command) for name, command in commands},
        "bus": _bus(health),
        "frames": _frames(health["frames"]),
        "ticks": _ticks(health["ticks"]),
        "recorder": _recorder(health.get("recorder")),
        "program": _program(health),
    }
    return [f"{name:<8} {text}" for name, text in facts.items()]


def _recorder(counts: results.RecorderCounts | None) -> str:
    """Whether this is recorded; an older gateway does not say."""
    if counts is None:
        return "none"
    if not counts["connected"]:
        return "not connected: nothing is recorded"
    lost = f"{counts['lost_datagrams']} lost with {counts['lost_frames']} frames"
    return f"connected, {counts['datagrams']} ticks handed over, {lost}"


def _demand(demand: results.DemandState | None) -> str:
    if demand is None:
        return "none"
    if demand["age_ms"] is None:
        return f"{demand['source']}, never expires"
    fresh = "fresh" if demand["fresh"] else "expired"
    return f"{demand['source']}, {duration(demand['age_ms'])} old, {fresh}"


def _command(command: results.ControllerCommand) -> str:
    mode = "POWER CUT" if command["power_cut"] else command["power_mode"]
    return (
        f"throttle {command['throttle_pct']:.1f} %  brake {command['brake_pct']:.1f} %  {mode}"
        f"  {'reverse' if command['motor_reverse'] else 'forward'}"
        f"  {command['speed_limit_rpm']:.0f} rpm  {command['power_limit_w']:.0f} W"
        f"  {_sent(command['sent'])}"
    )


def _sent(frame: results.CarriedFrame | None) -> str:
    return "nothing sent" if frame is None else f"{frame['frame']} {duration(frame['age_ms'])} ago"


def _bus(health: results.Health) -> str:
    link = health["link"]
    reason = f": {link['lost']}" if link["lost"] else ""
    state = f"{link['state']} for {duration(link['since_ms'])}{reason}"
    return f"{link['interface']} {link['channel']} {state}"


def _frames(frames: results.FrameCounts) -> str:
    parts = [f"{frames['received']} received", f"{frames['sent']} sent"]
    counted = {
        "dropped": frames["dropped"] or 0,
        "rejected": sum(frames["rejected"].values()),
        "unsent": sum(frames["unsent"].values()),
        "foreign": sum(frames["foreign_commands"].values()),
        "blocked by the gate": sum(frames["blocked_by_gate"].values()),
    }
    return ", ".join(parts + [f"{count} {what}" for what, count in counted.items()])


def _ticks(ticks: results.Ticks) -> str:
    late = ", ".join(
        f"{name} {value / 1000:.2f} ms"
        for name, value in (
            ("p50", ticks["lateness_p50_us"]),
            ("p99", ticks["lateness_p99_us"]),
            ("max", ticks["lateness_max_us"]),
        )
        if value is not None
    )
    return f"{ticks['done']} done, {ticks['skipped']} skipped; late {late or 'unknown'}"


def _program(health: results.Health) -> str:
    starts = "" if health["starts"] is None else f", start {health['starts']} since boot"
    if health["unexpected_restarts"]:
        starts += f", {health['unexpected_restarts']} of them unexpected in this drive"
    return (
        f"{health['versions']['vcu_gateway']}, pid {health['pid']},"
        f" up {duration(health['uptime_ms'])}{starts},"
        f" {health['config_file']} ({health['config_digest']})"
    )


@click.command("arm")
@api_options
def arm(socket_path: Path | None, as_json: bool) -> None:
    """Let the vehicle move: from standby to active.

    Refused, with the reason, while anything blocks it; a fresh demand without throttle is needed,
    such as `vcu-gateway demand` in another terminal makes.
    """
    with connected(socket_path) as client:
        granted = client.arm()
    show(granted, as_json, lambda: granted["mode"])


@click.command("disarm")
@api_options
def disarm(socket_path: Path | None, as_json: bool) -> None:
    """End the drive: from active to standby, zero torque at once."""
    with connected(socket_path) as client:
        granted = client.disarm()
    show(granted, as_json, lambda: granted["mode"])


@click.command("reset")
@api_options
@level_option("A cut needs service; `vcu-gateway why` says which.")
def reset(socket_path: Path | None, as_json: bool, level: results.FaultClassName) -> None:
    """Leave a latched fault, unarmed; refused, with the reason, while its cause is there."""
    with connected(socket_path) as client:
        granted = client.reset(level)
    show(granted, as_json, lambda: granted["mode"])


@click.command("reload")
@api_options
def reload(socket_path: Path | None, as_json: bool) -> None:
    """Read the configuration file again: all of it is taken, or nothing.

    While active only changes that make limits stricter are taken. Keys that need a restart are
    named. Without any error nothing else on the bus changes.
    """
    with connected(socket_path) as client:
        reloaded = client.reload()
    changed = ", ".join(reloaded["changed"]) or "nothing"
    show(reloaded, as_json, lambda: f"changed: {changed} ({reloaded['digest']})")


@click.command("why")
@api_options
def why(socket_path: Path | None, as_json: bool) -> None:
    """Print in one line why the vehicle does or does not move, and the next step."""
    with connected(socket_path) as client:
        why = client.why()
    show(why, as_json, lambda: why["sentence"])


@click.command("events")
@api_options
@click.option("-n", "--limit", type=click.IntRange(1, 200), default=50, show_default=True)
def events(socket_path: Path | None, as_json: bool, limit: int) -> None:
    """List the latest events, the latest last: when, how often, what."""
    with connected(socket_path) as client:
        events = client.events(limit)
    show(events, as_json, lambda: "\n".join(map(_line, events["events"])) or "no events")


def _line(event: results.EventEntry) -> str:
    fields = "  ".join(f"{name}={value}" for name, value in event["fields"].items())
    count = event["count"]
    repeats = f"{count} times in {duration(event['first_ms'])}" if count > 1 else ""
    entry = f"{event['last_time'][:23]}  {event['severity']:<8} {event['name']}  {fields}"
    return f"{entry}  ({repeats})" if repeats else entry


_NO_TUNING = "no curve, drive mode, slip limiter or pedal is configured; docs/tuning.md says how"
_NO_DRIVE_MODE = "no drive mode is configured; docs/tuning.md says how"


@click.command("tuning")
@api_options
def tuning(socket_path: Path | None, as_json: bool) -> None:
    """Show the drive mode and each curve: its input now, its limit now, whether that limits.

    A limit returns slowly while active, so it may be below what the curve says at its input.
    """
    with connected(socket_path) as client:
        found = client.tuning()
    show(found, as_json, lambda: "\n".join(_tuning_lines(found)))


def _tuning_lines(found: results.TuningNow) -> Iterator[str]:
    mode, slip_pct = found["drive_mode"], found["slip_throttle_max_pct"]
    pedals = found.get("pedals")
    if mode is None and slip_pct is None and pedals is None and not found["curves"]:
        yield _NO_TUNING
    if mode is not None:
        yield f"drive mode {_drive_mode_text(mode)}"
    if found["curves"]:
        heading = ("curve", "input", "limit", "")
        yield from table([heading, *map(_curve_row, found["curves"])], right=(1, 2))
    if slip_pct is not None:
        caps = ", ".join(f"{name} {pct:.0f} %" for name, pct in slip_pct.items())
        yield f"slip: throttle at most {caps}"
    if pedals is not None:
        yield f"pedals ({pedals['message']}): {pedals['sentence']}"


def _drive_mode_text(mode: results.DriveModeNow) -> str:
    others = ", ".join(name for name in mode["modes"] if name != mode["current"])
    waits = ""
    if mode["requested"] != mode["current"]:
        waits = (
            f"; {mode['requested']} waits for the pedal's release, and until then of both modes'"
            " limits the lower ones count"
        )
    return f"{mode['current']}{waits} (others: {others or 'none'})"


def _curve_row(curve: results.CurveNow) -> tuple[str, str, str, str]:
    x = "not known" if curve["x"] is None else f"{curve['x']:.4g} {curve['input_unit']}"
    cap = "none" if curve["cap"] is None else f"{curve['cap']:.0f} {curve['cap_unit']}"
    return curve["key"].removeprefix("curves."), x, cap, "limits" if curve["limits"] else ""


@click.command("drive-mode")
@api_options
@level_option("A mode with left_by_service is left at service level.")
@click.argument("mode", required=False)
def drive_mode(
    socket_path: Path | None, as_json: bool, level: results.FaultClassName, mode: str | None
) -> None:
    """Take another drive mode; without MODE, show which there are.

    While active it waits for the pedal's release where it would make a step; its limits of power,
    brake and speed count at once.
    """
    with connected(socket_path) as client:
        waits = mode is not None and client.set_drive_mode(mode, level)["waits_for_release"]
        found = client.tuning()["drive_mode"]
    if found is not None and mode is not None and not waits:
        found["current"] = mode  # from the next tick on
    show(found, as_json, lambda: _drive_mode_text(found) if found else _NO_DRIVE_MODE)


_ASK_EVERY_S = 0.05
_GRANTED = "Stop granted; it ends with: vcu-gateway reset --level service"
_NOT_TOLD = "Stop granted; this gateway is older and does not tell whether the controllers confirm"
_EXIT_CODES = {"cut": 0, "not obeyed": 1}
_NONE_LATCHED = "Stop granted; none is latched now"

Say = Callable[[str], None]


@click.command("estop", epilog="Exit code: 0 power is cut, 1 not obeyed, 75 not confirmed in time.")
@api_options
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(0, 3600),
    default=3.0,
    show_default=True,
    metavar="SECONDS",
    help="How long at most to wait for the controllers to confirm.",
)
@click.option("--no-wait", is_flag=True, help="Ask only; exit code 0 says that it was granted.")
def estop(socket_path: Path | None, as_json: bool, wait_s: float, no_wait: bool) -> None:
    """Emergency stop: cut the power of both controllers, and say whether they have.

    Every user who can open the socket may do this. It says how far the stop has come, on the bus
    and at the controllers, and waits until both confirm. Ctrl-C ends the waiting, not the stop,
    which ends with a reset at service level.
    """
    say: Say = (lambda _: None) if as_json else click.echo
    with connected(socket_path) as client:
        granted = client.estop()
        say(_GRANTED)
        stop = None if no_wait else _awaited(client, wait_s, say)
    if as_json:
        show({**granted, "stop": stop}, as_json, str)
    if not no_wait:
        sys.exit(_EXIT_CODES.get(stop["stage"] if stop else "", os.EX_TEMPFAIL))


def _awaited(client: Client, wait_s: float, say: Say) -> results.StopState | None:
    """The stop once both controllers have cut, or when the time is over; each change is said."""
    end_s, said = time.monotonic() + wait_s, ""
    while True:
        state = client.state(())
        if "stop" not in state:
            say(_NOT_TOLD)
            return None
        stop, is_over = state["stop"], time.monotonic() >= end_s
        sentence = stop["sentence"] if stop else _NONE_LATCHED if is_over else ""
        if sentence not in ("", said):  # until its tick a granted stop is not latched
            say(sentence)
            said = sentence
        if is_over or (stop and stop["stage"] == "cut"):
            return stop
        time.sleep(_ASK_EVERY_S)  # each tick brings another state at most
