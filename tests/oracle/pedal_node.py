"""The pedal node of config/examples/pedals.yaml, by hand from its DBC and docs/safety.md."""

from pathlib import Path
from typing import Any

import yaml

EXAMPLES = Path(__file__).parents[2] / "config" / "examples"
SECTIONS: dict[str, dict[str, Any]] = yaml.safe_load((EXAMPLES / "pedals.yaml").read_text("utf-8"))
SECTIONS["protocol"]["dbc"] = EXAMPLES / SECTIONS["protocol"]["dbc"]
KEYS = SECTIONS["pedals"]["can"]
MESSAGE = "Pedals_Position"
DEAD_ZONE_PCT = 3
FACTORS = {"throttle": 0.00125, "throttle_track2": 0.00125, "brake": 0.1}
# `step` of the counter from frame to frame; `wrong`: bits of the checksum that are.
RELEASED = {
    "throttle": 496,
    "throttle_track2": 248,
    "brake": 5,
    "reverse": 0,
    "step": 1,
    "wrong": 0,
}


def code(pedal: str, travel_pct: float) -> int:
    """The signal's raw value nearest to a travel."""
    ends = KEYS[pedal]
    value = ends["released"] + travel_pct / 100 * (ends["pressed"] - ends["released"])
    return round(value / FACTORS[pedal])


def travel_pct(pedal: str, raw: int) -> float:
    ends = KEYS[pedal]
    return (raw * FACTORS[pedal] - ends["released"]) / (ends["pressed"] - ends["released"]) * 100


def asked_pct(travel: float) -> float:
    return min(100.0, max(0.0, (travel - DEAD_ZONE_PCT) / (100 - 2 * DEAD_ZONE_PCT) * 100))


def _travel_for(pct: float) -> float:
    return DEAD_ZONE_PCT + pct / 100 * (100 - 2 * DEAD_ZONE_PCT) if pct else 0.0


def codes(demand: dict[str, Any]) -> dict[str, int]:
    """What the node sends for a demand: by default both tracks agree, brake released, forwards."""
    throttle = demand.get("throttle_pct", 0)
    return {
        "throttle": code("throttle", _travel_for(throttle)),
        "throttle_track2": code(
            "throttle_track2", _travel_for(demand.get("throttle_track2_pct", throttle))
        ),
        "brake": code("brake", _travel_for(demand.get("brake_pct", 0))),
        "reverse": int(demand.get("motor_reverse", False)),
    }


def demanded(raws: dict[str, int], coast: list[list[float]] | None = None) -> dict[str, Any]:
    """What one believed frame of these asks for; `coast`: two points of a curve."""
    travel = {pedal: travel_pct(pedal, raws[pedal]) for pedal in FACTORS}
    brake = asked_pct(travel["brake"])
    if coast:
        (_, most), (end, _) = coast
        higher = max(0.0, travel["throttle"], travel["throttle_track2"])
        brake = max(brake, most * (1 - min(higher, end) / end))
    return {
        "throttle_pct": asked_pct(travel["throttle"]), "brake_pct": brake, "regen_brake": True,
    }  # fmt: skip


def crc8_j1850(data: bytes) -> int:
    """CRC-8 of SAE J1850: polynomial 0x1D, begins with 0xFF, inverted at the end."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    return crc ^ 0xFF


def frame(values: dict[str, int], counter: int) -> bytes:
    word = (
        values["throttle"]
        | values["throttle_track2"] << 12
        | values["brake"] << 24
        | values["reverse"] << 34
        | counter << 48
    )
    data = word.to_bytes(7, "little")
    return data + bytes([crc8_j1850(data) ^ values["wrong"]])
