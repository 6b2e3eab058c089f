"""The traction battery: charge, voltage under load, temperature."""

import math

_CAPACITY_AH = 50.0
_EMPTY_V, _FULL_V = 62.0, 82.0
_RESISTANCE_OHM = 0.02
_HEAT_J_PER_K, _COOLING_S = 30_000.0, 1_200.0
_IDLE_CURRENT_A = 2.0

# State of charge below which CellUndervoltage is 1, 2, 3.
_UNDERVOLTAGE_SOC_PCT = (15.0, 5.0, 2.0)


class Battery:
    """The traction battery.

    Attributes:
        soc_pct: state of charge, 0..100.
        voltage_v: at the terminals, under load.
        current_a: positive while it discharges, negative while it is charged.
        temperature_c: of its middle.
    """

    def __init__(self, soc_pct: float, ambient_c: float, speedup: float) -> None:
        """Start at rest; charge flows `speedup` times as fast as it really would."""
        self.soc_pct = min(100.0, max(0.0, soc_pct))
        self.current_a = 0.0
        self.temperature_c = ambient_c
        self.voltage_v = self._open_circuit_v
        self._ambient_c = ambient_c
        self._speedup = speedup

    @property
    def undervoltage_level(self) -> int:
        """The code of CellUndervoltage."""
        return sum(self.soc_pct < limit_pct for limit_pct in _UNDERVOLTAGE_SOC_PCT)

    @property
    def discharge_relay_closed(self) -> bool:
        """False where the battery management has cut the motors off (undervoltage level 3)."""
        return self.undervoltage_level < len(_UNDERVOLTAGE_SOC_PCT)

    @property
    def state(self) -> int:
        """The code of BatteryState: 0 idle, 1 charging, 2 discharging."""
        if abs(self.current_a) < _IDLE_CURRENT_A:
            return 0
        return 1 if self.current_a < 0 else 2

    def step(self, power_w: float, dt_s: float) -> None:
        """Deliver this power (negative charges) for dt_s (s)."""
        open_v = self._open_circuit_v
        # power = (open_v - resistance * current) * current, the root of the lower current
        root_v2 = max(0.0, open_v**2 - 4 * _RESISTANCE_OHM * power_w)
        self.current_a = (open_v - math.sqrt(root_v2)) / (2 * _RESISTANCE_OHM)
        self.voltage_v = open_v - _RESISTANCE_OHM * self.current_a
        used_pct = 100 * self.current_a * dt_s * self._speedup / (_CAPACITY_AH * 3_600)
        self.soc_pct = min(100.0, max(0.0, self.soc_pct - used_pct))
        heat_w = _RESISTANCE_OHM * self.current_a**2
        cooling_k_per_s = (self.temperature_c - self._ambient_c) / _COOLING_S
        self.temperature_c += dt_s * (heat_w / _HEAT_J_PER_K - cooling_k_per_s)

    @property
    def _open_circuit_v(self) -> float:
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.soc_pct / 100
