"""Golden drives recorded: each script once, with the writer that every recording has."""

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from tests.golden.scripts import GoldenDrive
from tests.golden.simulate import begun, settings_of
from tests.recording.drive_writer import DriveWriter
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.recording import layout
from vcu_gateway.recording.members import Member, read_members
from vcu_gateway.recording.tap import Hello, Tap, TappedGateway
from vcu_gateway.units import NS_PER_S

CHANNEL = "can0"
FOLDER = Path(__file__).parent / "drives"
WALL_NS = 1_763_920_000 * NS_PER_S
# A segment that no drive fills, but the one whose clock leaps over a day.
SEGMENT_NS = 10**15
# What recorded it is no part of a golden drive: the same bytes come from every machine.
VERSIONS = dict.fromkeys(("gateway", "python", "kernel", "machine"), "golden")


def record(golden: GoldenDrive, parent: Path) -> Path:
    """Drive it, and record it in a folder of its name; the folder."""
    gateway = TappedGateway(golden.codec, settings_of(golden), golden.start_ns, Tap())
    folder, hello = parent / golden.name, _hello(golden)
    writer = DriveWriter(folder, hello, gateway, golden.start_ns, SEGMENT_NS)
    drive = begun(golden, gateway)
    drive.after_tick = lambda result: writer.after_tick(result.snapshot.now_ns)
    golden.script(drive)
    writer.close(drive.now_ns)
    link_dbc(folder, golden)
    return folder


def _hello(golden: GoldenDrive) -> dict:
    dbc = golden.dbc.read_text(encoding="utf-8")
    hello = Hello(
        run=hashlib.sha256(golden.name.encode()).hexdigest()[:32],
        boot="",
        channel=CHANNEL,
        clock=ClockPair(golden.start_ns, WALL_NS),
        settings=settings_of(golden),
        config=f"{golden.config}\n",
        config_digest=_digest(golden.config),
        dbc=dbc,
        dbc_digest=_digest(dbc),
    )
    return hello.values() | {"versions": VERSIONS}


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def link_dbc(folder: Path, golden: GoldenDrive) -> None:
    """One definition for all of them: that of the program, or of an example."""
    path = folder / layout.DBC_FILE
    path.unlink()
    path.symlink_to(os.path.relpath(golden.dbc, folder))


def contents(folder: Path) -> dict[str, str]:
    """Every file of a drive as text, unpacked: another zlib packs the same into other bytes."""
    files = [path for path in sorted(folder.iterdir()) if path.name != layout.DBC_FILE]
    return {path.name: "".join(_texts(path)) for path in files}


def _texts(path: Path) -> Iterator[str]:
    if path.suffix != ".gz":
        yield path.read_text(encoding="utf-8")
        return
    for part in read_members(path):
        assert isinstance(part, Member), f"{path}: {part}"
        yield part.data.decode()
