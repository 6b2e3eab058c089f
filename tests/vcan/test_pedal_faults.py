"""The simulator's pedal node, broken, beside a gateway on a real bus.

By the kernel's stamps of a recorder that is a process of its own.
"""

import itertools
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import pytest

from tests.vcan.conftest import CHANNEL, COMMANDS, Recorded, Stand, ended_after, program
from tests.vcan.pedal_node import (
    ASKED_RAW,
    MS,
    PEDALS_ID,
    SLACK_MS,
    arm_when_granted,
    configured,
    signals,
)
from tests.vcan.test_api import Drive, begin_alone
from vcu_gateway.core.can_pedals import checksum_of


class Fault(NamedTuple):
    """A fault of the node, how its first frame is known by the one before, and the bound.

    most_ms: from that frame to throttle 0; None where the drive goes on.
    """

    step: str
    is_first: Callable[[Recorded, Recorded], bool]
    most_ms: float | None
    foot: str = "[[0, 0], [5, 0], [5.5, 43]]"


def _apart(_: Recorded, after: Recorded) -> bool:
    first, second = (signals(after)[name] for name in ("Throttle1", "Throttle2"))
    return abs((first - 496) / 2584 - (second - 248) / 1288) > 0.1


TRACK = "Pedals_Position.Throttle1"
FAULTS = {
    "a wire open": Fault(
        f"fault: set, signal: {TRACK}, raw: 0",
        lambda _, after: signals(after)["Throttle1"] == 0,
        50,
    ),
    "a wire shorted": Fault(
        f"fault: set, signal: {TRACK}, raw: 3600",  # 20 % beyond its end, and a value of the signal
        lambda _, after: signals(after)["Throttle1"] == 3600,
        50,
    ),
    "a track stuck": Fault(
        f"fault: freeze, signal: {TRACK}",
        _apart,
        100 + 20 + 50,
        "[[0, 0], [5, 0], [5.5, 43], [9, 43], [9.02, 0]]",
    ),
    "tracks swapped": Fault(
        f"fault: swap, signal: {TRACK}, with_signal: Pedals_Position.Throttle2",
        _apart,
        100 + 20 + 50,
    ),
    "counter frozen": Fault(
        "fault: freeze, signal: Pedals_Position.Counter",
        lambda before, after: signals(before)["Counter"] == signals(after)["Counter"],
        60 + 50,
    ),
    "wrong checksum": Fault(
        "fault: set, signal: Pedals_Position.Checksum, raw: 1",  # the counter goes on
        lambda _, after: checksum_of(after.data[:7], "sae_j1850") != after.data[7],
        60 + 50,
    ),
    "late": Fault("fault: delay, of: PEDALS, delay_ms: 30", lambda *_: False, None),
    "doubled": Fault("fault: duplicate, of: PEDALS", lambda *_: False, None),
}


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drive]:
    """A gateway with pedals on CAN, and a recorder."""
    with ended_after(Stand(tmp_path_factory.mktemp("faults"), forking=True)) as stand:
        yield begin_alone(stand, configured(stand.folder), Drive)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_of_the_pedal_node_has_its_reaction(alone: Drive, name: str, figures: list[str]):
    fault, stand = FAULTS[name], alone.stand
    path = stand.folder / "scenario.yaml"
    path.write_text(f"foot: {{throttle_pct: {fault.foot}}}\nsteps: [{{at_s: 8, {fault.step}}}]\n")
    options = ("-c", str(stand.config_path), "--scenario", str(path), "--duration", "11")
    vehicle = stand.start("vehicle", *program("simulate", "--channel", CHANNEL, *options))
    arm_when_granted(alone)
    since_ns = time.time_ns()
    vehicle.popen.wait(30)
    frames = [frame for frame in alone.recording.frames() if frame.stamp_ns > since_ns]
    pedals = [frame for frame in frames if frame.can_id == PEDALS_ID]
    last_ns = pedals[-1].stamp_ns
    for can_id in COMMANDS:
        own = [one for one in frames if one.can_id == can_id and one.stamp_ns <= last_ns]
        driven = [one for one in own if one.data[1] == ASKED_RAW]
        assert driven, "the foot had no throttle"
        if fault.most_ms is None:
            assert own[-1].data[1] == ASKED_RAW
            after = [one for one in own if one.stamp_ns > driven[0].stamp_ns]
            assert {one.data[1] for one in after} == {ASKED_RAW}
            continue
        broken = next(
            after for before, after in itertools.pairwise(pedals) if fault.is_first(before, after)
        )
        zero = [one for one in own if one.stamp_ns > broken.stamp_ns and not one.data[1]]
        assert zero, "the throttle stayed"
        took_ms = (zero[0].stamp_ns - broken.stamp_ns) / MS
        assert took_ms <= fault.most_ms + SLACK_MS
        assert own[-len(zero) :] == zero, "throttle came back"
        figures.append(f"{name}: throttle 0 after {took_ms:.0f} ms, {fault.most_ms} at most")
    if fault.most_ms is None:
        figures.append(f"{name}: the same throttle in every frame")
