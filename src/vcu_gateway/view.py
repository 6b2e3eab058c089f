"""What a person sees: the gateway's state as a table in a terminal."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.output import OutFrame
from vcu_gateway.core.schedule import LATENESS_BOUNDS_NS, Schedule, lateness_at
from vcu_gateway.core.state import Quality, Reading, Snapshot
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.why import Why

_STYLES = {
    Quality.GOOD: "green",
    Quality.OUT_OF_RANGE: "yellow",
    Quality.SATURATED: "yellow",
    Quality.STALE: "red",
    Quality.NEVER: "dim",
}
_MODE_STYLES = {
    Mode.STARTING: "yellow",
    Mode.STANDBY: "cyan",
    Mode.ACTIVE: "green",
    Mode.FAULT: "bold red",
    Mode.STOPPING: "yellow",
}
_NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class Picture:
    """Everything one picture shows, taken at one tick.

    Attributes:
        title: what is running where.
        why: mode, reasons, what to do.
        commands: what each controller was told in this tick; frames: the bytes sent.
        rejected: frames not decoded, by reason; refused: frames not sent, by reason.
    """

    title: str
    why: Why
    snapshot: Snapshot
    commands: Mapping[str, Command]
    frames: tuple[OutFrame, ...]
    schedule: Schedule
    sent: int
    rejected: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    dropped: int | None = None


def render(picture: Picture, roomy: bool = True) -> RenderableType:
    """The picture for a terminal from 80 x 24 on; one line a message unless it is roomy."""
    return Group(
        Text(picture.title, style="bold", no_wrap=True, overflow="ellipsis"),
        Text(picture.why.sentence(), style=_MODE_STYLES[picture.why.mode]),
        Text(),
        _sent(picture),
        _health(picture),
        Text(),
        _received(picture.snapshot, roomy),
    )


def _received(snapshot: Snapshot, roomy: bool) -> Table:
    table = Table(expand=True, pad_edge=False, box=None, header_style="dim", padding=(0, 1))
    table.add_column("received", no_wrap=True, width=18)
    table.add_column("age ms", justify="right", no_wrap=True, width=6)
    table.add_column("Hz", justify="right", no_wrap=True, width=5)
    table.add_column("signals", ratio=1, no_wrap=not roomy, overflow="ellipsis")
    for message in snapshot.messages:
        latest = snapshot.latest(message.name)
        period_ns = latest.period_ns if latest else None
        table.add_row(
            Text(message.name, style="red" if snapshot.stale(message.name) else ""),
            _age(snapshot.age_ns(message.name)),
            f"{1e9 / period_ns:.1f}" if period_ns else "–",
            _signals(snapshot.readings(message.name)),
        )
    return table


def _age(age_ns: int | None) -> str:
    return "never" if age_ns is None else f"{age_ns / _NS_PER_MS:.0f}"


def _signals(readings: tuple[Reading, ...]) -> Text:
    text = Text()
    prefix = common_prefix([reading.name for reading in readings])
    # Quantities first, then what is not at its code 0: that is what a person looks for.
    shown = [one for one in readings if one.unit and one.value is not None]
    shown += [one for one in readings if not one.unit and (one.raw or _marked(one))]
    for index, reading in enumerate(shown):
        name = reading.name.removeprefix(prefix) or reading.name
        text.append(f"{'  ' if index else ''}{name} ", style="dim")
        text.append(_value(reading), style=_STYLES[reading.quality])
    return text


def common_prefix(names: list[str]) -> str:
    """The leading words, up to a capital or digit, that two or more names all share."""
    if len(names) < 2:
        return ""
    shortest = min(names, key=len)
    length = 0
    while length < len(shortest) and all(name[length] == shortest[length] for name in names):
        length += 1
    while length and any(len(name) > length and name[length].islower() for name in names):
        length -= 1
    return shortest[:length]


def _marked(reading: Reading) -> bool:
    return reading.quality is Quality.OUT_OF_RANGE


def _value(reading: Reading) -> str:
    if reading.code_name is not None:
        return reading.code_name
    value = reading.value
    number = f"{value:.0f}" if isinstance(value, int) else f"{value:.2f}"
    return f"{number} {reading.unit}".rstrip()


def _sent(picture: Picture) -> Table:
    table = Table(expand=True, pad_edge=False, box=None, header_style="dim", padding=(0, 1))
    for name in ("commanded", "throttle", "brake", "mode", "direction", "limits", "frame"):
        table.add_column(name, no_wrap=True, ratio=1 if name == "frame" else None)
    frames = {frame.controller: frame for frame in picture.frames}
    for controller in CONTROLLERS:
        command, frame = picture.commands[controller], frames.get(controller)
        table.add_row(
            controller,
            f"{command.throttle_pct:.1f} %",
            f"{command.brake_pct:.1f} %{' regen' if command.regen_brake else ''}",
            "POWER CUT" if command.power_cut else command.power_mode.name.lower(),
            "reverse" if command.motor_reverse else "forward",
            f"{command.speed_limit_rpm:.0f} rpm {command.power_limit_w:.0f} W",
            f"{frame.can_id:08X}#{frame.data.hex().upper()}" if frame else "silent",
        )
    return table


def _health(picture: Picture) -> Text:
    schedule = picture.schedule
    parts = [
        f"ticks {schedule.ticks}",
        f"skipped {schedule.skipped}",
        f"late p50 {_lateness(schedule, 0.5)} p99 {_lateness(schedule, 0.99)}",
        f"sent {picture.sent}",
        *_counted("not sent", picture.refused),
        *_counted("rejected", picture.rejected),
    ]
    if picture.dropped:
        parts.append(f"dropped by the kernel {picture.dropped}")
    return Text("  ".join(parts))


def _lateness(schedule: Schedule, share: float) -> str:
    bound_ns = lateness_at(schedule.lateness_counts, share)
    if bound_ns is None:
        return f"> {LATENESS_BOUNDS_NS[-1] / _NS_PER_MS:g} ms" if schedule.ticks else "–"
    return f"≤ {bound_ns / _NS_PER_MS:g} ms"


def _counted(what: str, counts: Mapping[str, int]) -> Iterator[str]:
    counted = [f"{reason} {count}" for reason, count in counts.items() if count]
    if counted:
        yield f"{what} {', '.join(counted)}"
