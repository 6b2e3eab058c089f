"""`vcu-gateway status`: summary of the running gateway."""

import sys
from pathlib import Path

import click

from vcu_gateway.api import results
from vcu_gateway.cli.api_options import api_options, connected, show
from vcu_gateway.text import duration


@click.command("status")
@api_options
@click.option("--check", is_flag=True, help="Exit with 1 unless the mode is standby or active.")
def command(socket_path: Path | None, as_json: bool, check: bool) -> None:
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
