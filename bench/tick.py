"""One tick in the running program: snapshot to both frames handed to the kernel."""

import sys
from collections.abc import Iterator
from dataclasses import replace

from bench import under_test
from bench.figures import Figure, Options, alone, compared, counts_finely, percentile
from bench.live import Live, run
from bench.traffic import NOMINAL_PER_S
from bench.under_test import OTHER
from bench.whole import runs

_FULL_S, _TURNS = 2.5, 11
_USUAL = """
curves:
  power_limit_w:
    by_motor_temperature_c: [[95, 14000], [110, 6000], [125, 0]]
    by_controller_temperature_c: [[75, 14000], [95, 2000]]
    by_soc_pct: [[3, 1500], [10, 5000], [25, 14000]]
drive_modes:
  start: eco
  modes:
    eco:
      throttle_pct: {by_pedal_pct: [[0, 0], [40, 20], [80, 55], [100, 80]]}
"""
_ALL = """
vehicle: {motor_rpm_per_kmh: 85.3}
curves:
  power_limit_w:
    by_motor_temperature_c: [[95, 14000], [110, 6000], [125, 0]]
    by_controller_temperature_c: [[75, 14000], [95, 2000]]
    by_pack_temperature_max_c: [[45, 14000], [60, 0]]
    by_pack_temperature_min_c: [[-10, 3000], [5, 14000]]
    by_soc_pct: [[3, 1500], [10, 5000], [25, 14000]]
    by_battery_voltage_v: [[60, 1000], [67, 14000]]
  brake_pct:
    by_soc_pct: [[90, 100], [98, 0]]
    by_motor_speed_rpm: [[150, 0], [600, 100]]
drive_modes:
  start: eco
  modes:
    eco:
      throttle_pct: {by_pedal_pct: [[0, 0], [40, 20], [80, 55], [100, 80]]}
      throttle_rise_pct_per_s: {by_speed_kmh: [[0, 30], [25, 80]]}
laws: {slip: {allowed_kmh: 5}}
"""
_TUNINGS = {"three curves and a map": (_USUAL, 25), "eight curves, map, rise, slip": (_ALL, 60)}
"""Configuration and the most µs that a tick may take more than without, by what is tuned."""


def figures(options: Options) -> Iterator[Figure]:
    if not counts_finely():
        return
    turns, name = runs(options, NOMINAL_PER_S), "tick, processor time"
    ours_us = [_cpu_us(live, 0.5) for live in turns["ours"]]
    yield alone(f"{name}, median", "µs", ours_us, 300, 220)
    if OTHER in turns:
        other_us = [_cpu_us(live, 0.5) for live in turns[OTHER]]
        yield compared(f"{name}, median", "µs", ours_us, other_us, OTHER, 0.85)
    yield alone(f"{name}, p99", "µs", [_cpu_us(live, 0.99) for live in turns["ours"]])
    yield from _tuned(options)


def _tuned(options: Options) -> Iterator[Figure]:
    """What tuning adds to a tick: with and without it in turns."""
    ours = under_test.gateway(under_test.HERE)
    programs = [ours, *(replace(ours, name=n, config=text) for n, (text, _) in _TUNINGS.items())]
    found: dict[str, list[float]] = {program.name: [] for program in programs}
    turns = options.turns(_TURNS)
    for turn in range(turns):
        for program in programs if turn % 2 == 0 else reversed(programs):
            live = run(program, NOMINAL_PER_S, options.seconds(_FULL_S))
            if not any(tick.mode == "active" for tick in live.ticks):
                raise RuntimeError(f"with {program.name} it did not drive")
            found[program.name].append(_cpu_us(live, 0.5))
        print(f"   with tuning and without, turn {turn + 1} of {turns}", file=sys.stderr)
    for name, (_, most_us) in _TUNINGS.items():
        more_us = [one - other for one, other in zip(found[name], found[ours.name], strict=True)]
        yield alone(f"tick with {name}: more than without", "µs", more_us, most_us)


def _cpu_us(live: Live, share: float) -> float:
    return percentile([tick.cpu_ns / 1e3 for tick in live.ticks], share)
