"""Every golden drive."""

from tests.golden import (  # noqa: F401 - each adds its own
    drives_bus,
    drives_can_pedals,
    drives_lifecycle,
    drives_pedals,
    drives_requests,
    drives_scenarios,
    drives_tuning,
    drives_vehicle,
)
from tests.golden.scripts import DRIVES

__all__ = ["DRIVES"]
