"""The simulated vehicle: everything on the bus but the gateway.

`motor` and `vehicle` are the physics, `nodes` has what each message carries of them and when it is
sent, `pedals` is a node of the vehicle's own, `faults` has how it all breaks; these are pure.
`scenario` has each fault, and reads from a file what breaks when; `play` puts everything on a bus.
"""

import random
from collections.abc import Sequence

from vcu_gateway.core.can_pedals import CanPedals
from vcu_gateway.core.codec import Codec
from vcu_gateway.simulator.nodes import Nodes, VehicleFault
from vcu_gateway.simulator.pedals import Foot, PedalNode
from vcu_gateway.simulator.vehicle import RESISTANCE_OHM, Vehicle


def build(
    codec: Codec,
    start_ns: int,
    *,
    soc_pct: float = 80.0,
    battery_speedup: float = 1.0,
    battery_resistance_ohm: float = RESISTANCE_OHM,
    seed: int = 0,
    faults: Sequence[VehicleFault] = (),
    pedals: CanPedals | None = None,
    foot: Foot | None = None,
) -> Nodes:
    """All nodes of a vehicle that stands still at start_ns; the seed decides the noise.

    `pedals` are those that the gateway is configured with, on which this foot rests.
    """
    vehicle = Vehicle(start_ns, soc_pct, battery_speedup, battery_resistance_ohm)
    noise = random.Random(seed)  # noqa: S311 - noise, not a secret
    node = None
    if pedals is not None:
        node = PedalNode(pedals, codec.by_name[pedals.message], foot or Foot())
    return Nodes(codec, vehicle, noise, faults, node)
