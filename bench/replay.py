"""Replay of a recorded drive: with its own configuration and a verdict, and as a what-if.

The drive is made in simulated time, with the nominal traffic of docs/protocol.md; figures are for
an hour of driving, in processor time of one core.
"""

import dataclasses
import gc
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.recording.drive_writer import DriveWriter

from bench.figures import Figure, Options, alone, counts_finely
from vcu_gateway import config as configuration
from vcu_gateway import simulator
from vcu_gateway.core import calls
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.recording.core_lines import CoreRecord, FrameRun
from vcu_gateway.recording.reader import Drive, open_drive
from vcu_gateway.recording.tap import Hello, Tap, TappedGateway
from vcu_gateway.replay.equality import EqualityCheck
from vcu_gateway.replay.judged import JudgedRecords
from vcu_gateway.replay.open_loop import OpenLoop

_PERIOD_NS = 50_000_000
_HOUR_S = 3600
_DRIVE_S = 120
_ARM_TICK = 60
_TARGET_S = 18.0
_WHAT_IF_TARGET_S = 20.0

Note = Callable[[FrameRun | CoreRecord], None]


def figures(options: Options) -> Iterator[Figure]:
    if not counts_finely():
        return
    seconds = options.seconds(_DRIVE_S)
    with tempfile.TemporaryDirectory() as folder:
        drive = open_drive(_recorded(Path(folder) / "drive", seconds))
        protocol = drive.protocol
        codec, settings = Codec(protocol), drive.info.settings
        slower = dataclasses.replace(settings, throttle_slew_pct_per_s=50.0)
        ways: dict[str, tuple[Callable[[], list[Note]], float | None]] = {
            "replay an hour, every result and why compared": (
                lambda: [EqualityCheck(codec).note],
                _TARGET_S,
            ),
            "the same, with a verdict": (
                lambda: [
                    EqualityCheck(codec).note,
                    JudgedRecords(settings, protocol.aliases).note,
                ],
                None,
            ),
            "what-if of an hour": (lambda: [OpenLoop(codec, slower).note], _WHAT_IF_TARGET_S),
        }
        took: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(options.repeats(3)):
            for name, (make, _) in ways.items():
                took[name].append(_took_s(drive, make()) * _HOUR_S / seconds)
    for name, (_, target_s) in ways.items():
        yield alone(name, "s", took[name], target_s)


def _took_s(drive: Drive, notes: list[Note]) -> float:
    gc.disable()
    before_s = time.process_time()
    for record in drive.runs():
        for note in notes:
            note(record)
    gc.enable()
    return time.process_time() - before_s


def _recorded(folder: Path, seconds: float) -> Path:
    """A drive whose throttle changes every three seconds."""
    text = "bus: {channel: can0}\n"
    config = configuration.parse(text, "config.yaml")
    settings, now_ns = configuration.core_settings(config), 10**12
    codec = Codec(dbc.load(packaged("vcu.dbc")))
    gateway = TappedGateway(codec, settings, now_ns, Tap())
    nodes = simulator.build(codec, now_ns)
    contents = packaged("vcu.dbc").read_text(encoding="utf-8")
    clock = ClockPair(now_ns, 1_795_000_000 * 10**9)
    hello = Hello("0" * 32, "", "can0", clock, settings, text, "", contents, "")
    writer = DriveWriter(folder, hello.values(), gateway, now_ns)
    gateway.apply(calls.OpenLink(LinkStatus(LinkState.UP, now_ns), None, now_ns))
    for tick in range(round(seconds * 20)):
        now_ns += _PERIOD_NS
        while (due_ns := nodes.next_due_ns()) <= now_ns:
            for one in nodes.due(due_ns):
                gateway.receive(Frame(one.can_id, one.data, due_ns))
        throttle_pct = 0.0 if tick <= _ARM_TICK else 20.0 * (tick // 60 % 4)
        both = dict.fromkeys(CONTROLLERS, ControllerDemand(throttle_pct=throttle_pct))
        gateway.apply(calls.Offer(Demand("driver", tick + 1, 200, both), now_ns))
        if tick == _ARM_TICK:
            gateway.apply(calls.Arm(now_ns))
        result = gateway.tick(now_ns)
        for frame in result.frames:
            gateway.apply(calls.NoteSent(frame, True, now_ns))
        for frame in result.frames:
            nodes.receive(frame.can_id, frame.data, now_ns)
            gateway.receive(Frame(frame.can_id, frame.data, now_ns, own_echo=True))
        writer.after_tick(now_ns)
    writer.close(now_ns)
    return folder
