"""Recorded drives in simulated time, for tests."""

import hashlib
from pathlib import Path

from tests.core.simulated_drive import PERIOD_NS
from tests.recording.drive_writer import DriveWriter
from tests.recording.tapped import TappedDrive
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.protocol import packaged
from vcu_gateway.recording.tap import Hello
from vcu_gateway.units import NS_PER_S

WALL_NS = 1_763_920_000 * NS_PER_S + 123_456_789


def hello_of(drive: TappedDrive) -> Hello:
    dbc = packaged("vcu.dbc").read_text(encoding="utf-8")
    return Hello(
        run="0123456789abcdef",
        boot="",
        channel="can0",
        clock=ClockPair(drive.now_ns, WALL_NS),
        settings=drive.gateway.settings,
        config="limits: {}\n",
        config_digest="0" * 16,
        dbc=dbc,
        dbc_digest=hashlib.sha256(dbc.encode()).hexdigest()[:16],
    )


class RecordedDrive(TappedDrive):
    """Every tick is written into `folder`; `results` has what really happened."""

    def __init__(self, folder: Path, segment_ns: int = 60 * NS_PER_S, **settings) -> None:
        super().__init__(**settings)
        values = hello_of(self).values()
        self.writer = DriveWriter(folder, values, self.gateway, self.now_ns, segment_ns)
        self.results: list[TickResult] = []
        self.sentences: list[str] = []

    def tick(self, after_ns: int = PERIOD_NS) -> TickResult:
        result = super().tick(after_ns)
        self.results.append(result)
        self.sentences.append(self.sentence)
        self.writer.after_tick(self.now_ns)
        return result

    def close(self) -> None:
        self.writer.close(self.now_ns)
