"""What being recorded costs the gateway: with a recorder and without, in turns of one run.

With the policies of their units, where these are allowed: where both share a processor, a recorder
that is as urgent as its gateway would be what is measured.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from socket import AF_UNIX, SOCK_SEQPACKET, socket

from bench import under_test
from bench.figures import Figure, Options, compared, compared_tails, counts_finely
from bench.live import Live, run
from bench.priority import may_be_punctual
from bench.recorder import recorder, tap_path
from bench.traffic import NOMINAL_PER_S

_FULL_S = 5.0
_TURNS = 10
_LISTENS_WITHIN_S = 20.0
_PEER = "not recorded"


def figures(options: Options) -> Iterator[Figure]:
    recorded, alone = _turns(options)
    for name, share, target in (("p50", 0.5, None), ("p99", 0.99, 1.05)):
        ours, peer = ([_lateness_us(live) for live in way] for way in (recorded, alone))
        title = f"tick lateness while recorded, {name}"
        yield compared_tails(title, "µs", share, ours, peer, _PEER, target)
    if counts_finely():
        yield _compared("whole program while recorded", "% of a core", recorded, alone, _share_pct)
    yield _compared("resident memory while recorded", "MB", recorded, alone, _resident_mb)
    missed = sum(live.cadence.missed for live in recorded)
    yield Figure("cycles without a frame while recorded", "", missed, target=0, absolute=True)


def _turns(options: Options) -> tuple[list[Live], list[Live]]:
    """Runs of the recorded gateway, and of one that hands nothing on."""
    ours = under_test.gateway(under_test.HERE)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as recording:
        recording.enter_context(recorder(Path(folder)))
        path = tap_path(Path(folder))
        _wait_for(path)
        recorded = replace(ours, config=f"recorder: {{socket_path: {path}}}\n")
        alone = replace(ours, name=_PEER, config="recorder: {socket_path: null}\n")
        found: dict[str, list[Live]] = {recorded.name: [], alone.name: []}
        turns, policy = options.turns(_TURNS), ["fifo"] if may_be_punctual() else []
        for turn in range(turns):
            for program in (recorded, alone) if turn % 2 == 0 else (alone, recorded):
                live = run(program, NOMINAL_PER_S, options.seconds(_FULL_S), *policy)
                found[program.name].append(live)
            print(f"   with a recorder and without, turn {turn + 1} of {turns}", file=sys.stderr)
        drives = len(list(Path(folder).glob("kept/drives/*/0001.frames.log.gz")))
        if drives != turns:
            raise RuntimeError(f"{drives} of {turns} drives were recorded")
    return found[recorded.name], found[alone.name]


def _wait_for(path: Path) -> None:
    end_s = time.monotonic() + _LISTENS_WITHIN_S
    while time.monotonic() < end_s:
        with socket(AF_UNIX, SOCK_SEQPACKET) as probe, suppress(OSError):
            probe.connect(str(path))
            return
        time.sleep(0.02)
    raise TimeoutError(f"no recorder listens on {path}")


def _compared(
    name: str, unit: str, recorded: list[Live], alone: list[Live], value: Callable[[Live], float]
) -> Figure:
    ours, peer = ([value(live) for live in way] for way in (recorded, alone))
    return compared(name, unit, ours, peer, _PEER)


def _lateness_us(live: Live) -> list[float]:
    return [tick.lateness_ns / 1e3 for tick in live.ticks]


def _share_pct(live: Live) -> float:
    return live.share_pct


def _resident_mb(live: Live) -> float:
    return live.resident_mb
