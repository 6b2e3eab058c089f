"""Whole programs in turns: processor, memory, ticks and cadence on the wire."""

import sys
from collections.abc import Callable, Iterator
from functools import cache

from bench import under_test
from bench.figures import Figure, Options, alone, compared, compared_tails, counts_finely
from bench.live import Live, run
from bench.traffic import NOMINAL_PER_S, SATURATED_PER_S
from bench.under_test import C_A_FRAME, C_A_TICK, NAIVE, OTHER

_FULL_S = {NOMINAL_PER_S: 2.5, SATURATED_PER_S: 1.0}
# Two starts of one program differ more than two stretches of one run.
_TURNS = {NOMINAL_PER_S: 11, SATURATED_PER_S: 7}

Turns = dict[str, list[Live]]
"""Runs of each program by its name; those of one turn have the same index."""


@cache
def runs(options: Options, per_s: int) -> Turns:
    """Every program in turns; kept, because several benchmarks look at them."""
    seconds, turns = options.seconds(_FULL_S[per_s]), options.turns(_TURNS[per_s])
    programs = [*under_test.gateways(options), NAIVE, *under_test.floors()]
    found: Turns = {program.name: [] for program in programs}
    for turn in range(turns):
        # Every other turn backwards: none has always the same one before it.
        for program in programs if turn % 2 == 0 else reversed(programs):
            found[program.name].append(run(program, per_s, seconds))
        shares = ", ".join(f"{name} {of[-1].share_pct:.2f} %" for name, of in found.items())
        print(f"   {per_s} frames/s, turn {turn + 1} of {turns}: {shares}", file=sys.stderr)
    return found


def figures(options: Options) -> Iterator[Figure]:
    turns = runs(options, NOMINAL_PER_S)
    yield from shares(turns, NOMINAL_PER_S, 0.65, 0.5)
    for peer in (NAIVE.name, OTHER, C_A_TICK.name):
        name = f"times woken at {NOMINAL_PER_S} frames/s"
        yield from _against(turns, name, "a second", _woken_per_s, peer)
    ticks = [[tick.mode == "active" for tick in live.ticks] for live in turns["ours"]]
    torque_pct = [100 * sum(active) / len(active) for active in ticks]
    yield alone("ticks with torque", "%", torque_pct)
    yield from _against(turns, "resident memory", "MB", _resident_mb, NAIVE.name, 1.2, 1.1)
    yield from _against(turns, "resident memory", "MB", _resident_mb, OTHER)
    yield from _cadence(turns, options.seconds(_FULL_S[NOMINAL_PER_S]))


def shares(turns: Turns, per_s: int, target: float, stretch: float) -> Iterator[Figure]:
    """Of a core, beside each peer."""
    if not counts_finely():
        return
    name, unit = f"whole program at {per_s} frames/s", "% of a core"
    yield from _against(turns, name, unit, _share_pct, NAIVE.name, target, stretch)
    for peer in (OTHER, C_A_TICK.name, C_A_FRAME.name):
        yield from _against(turns, name, unit, _share_pct, peer)


def _against(
    turns: Turns,
    name: str,
    unit: str,
    value: Callable[[Live], float],
    peer: str,
    target: float | None = None,
    stretch: float | None = None,
) -> Iterator[Figure]:
    """Ours beside one peer; nothing where that did not run."""
    if peer in turns:
        ours, other = ([value(live) for live in turns[who]] for who in ("ours", peer))
        yield compared(name, unit, ours, other, peer, target, stretch)


def _share_pct(live: Live) -> float:
    return live.share_pct


def _resident_mb(live: Live) -> float:
    return live.resident_mb


def _woken_per_s(live: Live) -> float:
    return live.woken_per_s


def _mean_off_ms(live: Live) -> float:
    return live.cadence.mean_off_ms


def _cadence(turns: Turns, seconds: float) -> Iterator[Figure]:
    name = "mean period on the wire, away from 50 ms"
    yield from _against(turns, name, "ms", _mean_off_ms, NAIVE.name)
    ours_ms, naive_ms = (
        max(abs(live.cadence.drift_ms) for live in turns[who]) for who in ("ours", NAIVE.name)
    )
    # 0.5 and 0.1 ms in 5 s; less than a quarter of a millisecond is lateness in so short a time.
    share = max(seconds, _FULL_S[NOMINAL_PER_S]) / 5
    limits_ms = 0.5 * share, 0.1 * share
    name = f"drift over {seconds:g} s"
    yield Figure(name, "ms", ours_ms, naive_ms, NAIVE.name, *limits_ms, absolute=True)
    for peer, target, stretch in (
        (C_A_TICK.name, 5.0, 2.0),
        (NAIVE.name, None, None),
        (OTHER, None, None),
    ):
        if peer in turns:
            ours_us, peer_us = (
                [live.cadence.errors_us for live in turns[who]] for who in ("ours", peer)
            )
            name = "p99 error of the period on the wire"
            yield compared_tails(name, "µs", 0.99, ours_us, peer_us, peer, target, stretch)
    missed = sum(live.cadence.missed for live in turns["ours"])
    yield Figure("cycles without a frame", "", missed, target=0, absolute=True)
