"""How fast the motors turn, as far as that is known."""

from typing import NamedTuple

from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.plausibility import Observed
from vcu_gateway.core.state import Snapshot

SpeedsRpm = tuple[float | None, ...]


class Speeds(NamedTuple):
    """Lowest and highest speed of each motor in the frames since the tick before.

    None where one of them is out of range or follows a step that no motor makes, or the last
    one is stale.
    """

    lowest_rpm: SpeedsRpm
    highest_rpm: SpeedsRpm


UNKNOWN = Speeds(*[(None,) * len(CONTROLLERS)] * 2)


def of(snapshot: Snapshot, observed: Observed) -> Speeds:
    """The speeds of both motors at a tick."""
    values = [
        ()
        if name in observed.speed_steps_rpm
        else snapshot.good_values(f"{name}_Status2", "MotorSpeed")
        for name in CONTROLLERS
    ]
    return Speeds(
        tuple([min(speeds) if speeds else None for speeds in values]),
        tuple([max(speeds) if speeds else None for speeds in values]),
    )
