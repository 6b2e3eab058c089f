"""Settings of the core that a configuration gives."""

from vcu_gateway.config.model import Config
from vcu_gateway.config.vehicle import BenchDemandSection
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.settings import KEYS, Settings


def core_settings(config: Config) -> Settings:
    """The core's settings, the bench demand with them."""
    values = {name: getattr(getattr(config, key.section), name) for name, key in KEYS.items()}
    demand = config.bench.demand
    return Settings(**values, bench_demand=None if demand is None else _bench_demand(demand))


def _bench_demand(demand: BenchDemandSection) -> ControllerDemand:
    values = demand.model_dump(exclude={"bench_use_only", "power_mode"})
    return ControllerDemand(**values, power_mode=PowerMode[demand.power_mode.upper()])
