"""Ranges of a demand's quantities, for core, configuration, API and clients."""

from collections.abc import Mapping

SPEED_LIMIT_HIGHEST_RPM = 12_000
"""Largest SpeedLimit of the command (docs/protocol.md); a test compares it with the definition."""

POWER_LIMIT_HIGHEST_W = 60_000
"""Largest PowerLimit of the command (docs/protocol.md); a test compares it with the definition."""

RANGES: Mapping[str, tuple[float, float]] = {
    "throttle_pct": (0, 100),
    "brake_pct": (0, 100),
    "speed_limit_rpm": (0, SPEED_LIMIT_HIGHEST_RPM),
    "power_limit_w": (0, POWER_LIMIT_HIGHEST_W),
    "throttle_track2_pct": (0, 100),
}
"""Lowest and highest value of each quantity of a demand."""


def span(name: str) -> str:
    """The range of a quantity for a person, as "0 to 100"."""
    lowest, highest = RANGES[name]
    return f"{lowest:g} to {highest:g}"
