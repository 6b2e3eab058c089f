"""A part of `make soak`, where minutes to hours of it run."""

import os
from pathlib import Path

import pytest

from tests.faults.conftest import Seen
from tests.faults.soak import soaking
from tests.faults.vcan.conftest import ReadyDriving

SLOW_S = int(os.environ.get("VCU_SOAK_S", "600"))


@pytest.mark.parametrize(
    "seconds",
    [
        pytest.param(15, marks=[pytest.mark.ci, pytest.mark.timeout(300)]),
        pytest.param(SLOW_S, marks=[pytest.mark.slow, pytest.mark.timeout(2 * SLOW_S)]),
    ],
)
def test_f80_driving_with_random_faults_keeps_the_invariants_and_leaves_nothing_behind(
    seconds: int, ready_driving: ReadyDriving, tmp_path: Path, seen: Seen
):
    ready_driving.clear()
    with soaking(tmp_path, seed=80, tell=print) as soak:
        soaked = soak.run(seconds)
    seen(str(soaked))
    assert not soaked.wrong
