"""A gateway on vcan0 whose drive is recorded by a recorder, and what is on the disk afterwards."""

import contextlib
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

# Imported for the processes that are forked from this one.
import vcu_gateway.cli.recorder
import vcu_gateway.cli.replay  # noqa: F401
from tests.faults.breakable_vehicle import Breaking
from tests.faults.driving import BusStand
from tests.recorder.gateway import core_lines, recorded_frames
from tests.vcan.conftest import Forked, Process, ended_after, program, wait_until
from vcu_gateway.recording import layout

NS_PER_S = 1_000_000_000
# An incident that ends with its drive, or begins with it, is as long as the drive is.
SLACK_S = 2.0
REPLAYED_WITHIN_S = 600.0


@dataclass
class RecordedStand(BusStand):
    """A stand whose gateways hand their drives to the recorder that it starts.

    Attributes:
        disk: where the recorder writes; the stand's folder where it is None.
    """

    disk: Path | None = None

    @property
    def recordings(self) -> Path:
        return (self.disk or self.folder) / "recordings"

    @property
    def tap_path(self) -> Path:
        return self.folder / "tap.sock"

    @property
    def status_path(self) -> Path:
        return self.folder / "recorder-status.json"

    def configure(self, config: str) -> None:
        super().configure(f"recorder: {{socket_path: {self.tap_path}}}\n{config}")

    def recorder(self, *options: str) -> Process:
        """`vcu-gateway recorder`, listening."""
        paths = ("--folder", self.recordings, "--socket", self.tap_path)
        more = ("--status", self.status_path, "--keep-free-bytes", "0", *options)
        name = f"tap-recorder-{len(self.children)}"
        child = self.start(name, *program("recorder", *map(str, (*paths, *more))))
        wait_until(self.tap_path.exists, f"the recorder: {child.err}")
        return child

    def status(self) -> dict[str, Any]:
        """What the recorder tells of itself, once a second; empty before it does."""
        with contextlib.suppress(OSError, ValueError):
            told: dict[str, Any] = json.loads(self.status_path.read_text())
            return told
        return {}

    def drives(self) -> list[Path]:
        return layout.recorded_folders(self.recordings / layout.DRIVES)

    def incidents(self) -> list[Path]:
        return layout.recorded_folders(self.recordings / layout.INCIDENTS)


@contextlib.contextmanager
def recorded_in(
    folder: Path, disk: Path | None = None, *options: str
) -> Iterator[tuple[Breaking, Process]]:
    """A recorded gateway with a vehicle that a test breaks; and its recorder."""
    with ended_after(RecordedStand(folder, forking=True, disk=disk)) as stand:
        recorder = stand.recorder(*options)
        one = Breaking(stand)
        try:
            one.start_vehicle()
            one.until_serving()
            wait_until(lambda: one.client.health()["recorder"]["connected"], "the tap")
            yield one, recorder
        finally:
            one.let_go()


class Account(NamedTuple):
    """Frames of a drive: on the disk, told as gaps, and handed on by the gateway in all."""

    recorded: int
    lost: int
    ticks: int
    gaps: int
    handed_on: int


def account(drive: Path) -> Account:
    """Of every segment in turn; AssertionError where one does not go on where the last ended."""
    recorded = lost = ticks = gaps = expected = 0
    for segment in layout.segments(drive):
        lines = core_lines(segment)
        assert "checkpoint" in lines[0], segment
        gap = next((line["gap"] for line in lines[2:3] if "gap" in line), {})
        missing = gap.get("frames") or 0
        assert lines[1]["begin"]["frames"] == expected + missing, (lines[1], gap, expected)
        here = recorded_frames(segment)
        expected = lines[1]["begin"]["frames"] + here
        recorded, lost, gaps = recorded + here, lost + missing, gaps + bool(gap)
        ticks += sum("tick" in line for line in lines)
    return Account(recorded, lost, ticks, gaps, expected)


def recorded_ticks(drive: Path) -> list[dict[str, Any]]:
    """The lines of all ticks on the disk."""
    lines = [line for segment in layout.segments(drive) for line in core_lines(segment)]
    return [line for line in lines if "tick" in line]


class Replay(NamedTuple):
    """What `vcu-gateway replay --json` says, and its exit code."""

    code: int
    told: dict[str, Any]
    errors: str


def replay(path: Path) -> Replay:
    """By a process that is forked from this one: a fresh Python takes a second more in the lab."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        child = Forked(["replay", str(path), "--json"], out.fileno(), err.fileno(), {})
        child.start()
        code = child.wait(REPLAYED_WITHIN_S)
        out.seek(0)
        err.seek(0)
        told, errors = out.read(), err.read()
    with contextlib.suppress(ValueError):
        return Replay(code, json.loads(told), errors)
    return Replay(code, {}, told + errors)


def wall_s(stamp: str) -> float:
    return datetime.fromisoformat(stamp).timestamp()
