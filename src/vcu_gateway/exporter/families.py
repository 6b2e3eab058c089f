"""All families of metrics."""

from vcu_gateway.exporter import bus, process, program, recorder, vehicle
from vcu_gateway.exporter.family import Family

FAMILIES: tuple[Family, ...] = (
    *vehicle.FAMILIES,
    *bus.FAMILIES,
    *program.FAMILIES,
    *recorder.FAMILIES,
    *process.FAMILIES,
)
"""In the order of the text."""
