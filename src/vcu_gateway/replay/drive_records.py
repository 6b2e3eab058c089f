"""Records of a drive for a replay: its codec, its configuration, and the part that is asked for."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.drive.reader import Drive
from vcu_gateway.drive.records import Checkpoint, CoreRecord, FrameRun, TickRecord
from vcu_gateway.drive_format import layout
from vcu_gateway.errors import DataError
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, requirements
from vcu_gateway.replay.time_of_day import TimeOfDay
from vcu_gateway.strict_yaml import parser
from vcu_gateway.time_window import Window

_MOST_PROBLEMS = 5


def protocol_of(drive: Drive) -> ProtocolSpec:
    """The DBC beside a drive, with the aliases of its configuration.

    DataError where no gateway can drive with it.
    """
    path = drive.folder / layout.DBC_FILE
    protocol = dbc.load(path)
    if unmet := requirements.unmet(protocol, lambda *_: str(path)):
        raise DataError(*unmet[:_MOST_PROBLEMS])
    return with_aliases(protocol, recorded_aliases(drive.info.config))


def with_aliases(protocol: ProtocolSpec, aliases: Mapping[int, str]) -> ProtocolSpec:
    """The same messages with these further identifiers."""
    return dataclasses.replace(protocol, aliases=dict(aliases))


def recorded_aliases(config: str) -> Mapping[int, str]:
    """Further identifiers of messages in a recorded configuration, whatever wrote it."""
    values = parser.read(config).value
    section = values.get("protocol") if isinstance(values, dict) else None
    aliases: Any = section.get("aliases") if isinstance(section, dict) else None
    if not isinstance(aliases, dict):
        return DEFAULT_ALIASES
    return {int(str(key), 0): str(name) for key, name in aliases.items()}


def records(drive: Drive, window: Window, clock: TimeOfDay) -> Iterator[FrameRun | CoreRecord]:
    """Records of a part, from the last checkpoint before its begin to the last tick in it."""
    if window.open:
        yield from drive.runs()
        return
    begins = {number: clock.wall_ns(now_ns) for number, now_ns in _checkpoints(drive)}
    from_ns, to_ns = window.bounds_ns(min(begins.values(), default=0))
    before = [number for number, wall_ns in begins.items() if wall_ns <= from_ns]
    for record in drive.runs(max(before, default=None)):
        if type(record) is TickRecord and clock.wall_ns(record.now_ns) > to_ns:
            return
        yield record


def _checkpoints(drive: Drive) -> Iterator[tuple[int, int]]:
    """Number of each segment that begins with a checkpoint, and its time on the gateway's clock."""
    for files in drive.segments:
        for record in Drive(drive.folder, drive.info, (files,)).runs():
            if type(record) is Checkpoint:
                yield files.number, record.now_ns
                break
