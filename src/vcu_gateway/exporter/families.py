"""Everything that is exposed."""

from vcu_gateway.exporter import bus, program, vehicle
from vcu_gateway.exporter.family import Family

FAMILIES: tuple[Family, ...] = (*vehicle.FAMILIES, *bus.FAMILIES, *program.FAMILIES)
"""In the order of the text; prometheus_client's own process_* families follow."""
