"""Golden drives driven: a script, a gateway core and the simulated vehicle, in simulated time."""

import itertools
from pathlib import Path

from tests.core.simulated_drive import CODEC
from tests.golden.scripted_drive import ScriptedDrive
from tests.golden.scripts import GoldenDrive
from vcu_gateway.config import core_settings, parse
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.settings import Settings
from vcu_gateway.recording.core_lines import LineWriter, WhyRecord
from vcu_gateway.recording.tap import Tap, TappedGateway
from vcu_gateway.simulator.scenario import load

WHY_EVERY_TICKS = 20
SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"


def settings_of(golden: GoldenDrive) -> Settings:
    """The core's settings of a drive's configuration."""
    return core_settings(parse(golden.config, "gateway.yaml"))


def begun(golden: GoldenDrive, gateway: TappedGateway) -> ScriptedDrive:
    """The drive at its first instant; `why` is noted where something happens, and now and then."""
    more: dict = {}
    if golden.scenario:
        scenario = load(SCENARIOS / golden.scenario, CODEC.protocol)
        more = {
            "soc_pct": scenario.start.soc_pct,
            "faults": scenario.faults(CODEC, golden.start_ns),
        }
    more |= {"quiet": golden.quiet, "codec": golden.codec}
    drive = ScriptedDrive(gateway, golden.start_ns, **more)
    ticks = itertools.count()

    def note(result: TickResult) -> None:
        if result.events or next(ticks) % WHY_EVERY_TICKS == 0:
            now_ns = result.snapshot.now_ns
            gateway.tap.note(WhyRecord(now_ns, gateway.why(now_ns).sentence()))

    drive.after_tick = note
    return drive


def core_text(golden: GoldenDrive) -> str:
    """The core lines of a drive, without a checkpoint."""
    gateway = TappedGateway(golden.codec, settings_of(golden), golden.start_ns, Tap())
    drive = begun(golden, gateway)
    golden.script(drive)
    frames, calls = gateway.tap.take()
    return LineWriter().lines(calls, len(frames))
