"""Drives of ten seconds with the simulated pedal node, whole or broken."""

from tests.simulator.driving import Drive, drive, signals
from vcu_gateway.config import core_settings, load
from vcu_gateway.core.codec import Codec
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.scenario import parse

CODEC = Codec(dbc.load(packaged("pedals.dbc")))
PEDALS = core_settings(load(packaged("pedals.yaml"))).pedals
PRESS = "foot: {throttle_pct: [[0, 0], [4, 0], [4.5, 43]]}"  # asks for 42.55 %
BREAKS_S = 7.0
DRIVEN_PCT = 40.0


def driven(fault: str = "", foot: str = PRESS) -> Drive:
    """The foot presses at 4 s, and something breaks at 7 s."""
    step = f"steps: [{{at_s: {BREAKS_S}, {fault}}}]" if fault else ""
    scenario = parse(f"{foot}\n{step}", "a scenario", CODEC.protocol)
    return drive(CODEC, scenario, 10, None, pedals=PEDALS)


def throttle_pct(done: Drive, at_s: float) -> float:
    return signals(CODEC, done.tick_at(at_s).frames[0])["Throttle"]
