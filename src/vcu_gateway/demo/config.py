"""What the demo runs: the user's configuration on the demo's own bus, and the user's scenario."""

import dataclasses
from pathlib import Path

from vcu_gateway import config as configuration
from vcu_gateway.config import BenchDemandSection, BenchSection, Config
from vcu_gateway.config.checks import check_protocol, load_protocol
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.demo.process import DemoOptions
from vcu_gateway.errors import ConfigError
from vcu_gateway.simulator import scenario
from vcu_gateway.simulator.scenario import Scenario, ScenarioStart

_THROTTLE_PCT = 30.0
_BATTERY_SPEEDUP = 20.0  # a person waits, and wants to see it drain


def load(wanted: DemoOptions) -> tuple[Config, ProtocolSpec, Scenario]:
    """Read the files and put the demo together; GatewayError names everything wrong in them."""
    config = _config(wanted)
    protocol = load_protocol(config)
    check_protocol(config, protocol)
    if problems := configuration.check_against(config, protocol):
        raise ConfigError(*problems)
    return config, protocol, _scenario(wanted, protocol)


def _config(wanted: DemoOptions) -> Config:
    """All that the file says, but for the bus, the sockets and who may use them."""
    path = wanted.config_path
    file = configuration.of_values({}, "demo") if path is None else configuration.load(Path(path))
    bus = {"interface": wanted.interface, "channel": wanted.channel}
    accounts = dict.fromkeys(
        ("operator_users", "operator_groups", "service_users", "service_groups"), ()
    )
    api = {
        "enabled": True,
        "socket_path": wanted.socket_path,
        "socket_mode": "0600",
        "socket_owner": None,
        "socket_group": None,
        **accounts,
    }
    recorder = {"socket_path": wanted.recorder_socket}
    return file.model_copy(
        update={
            "bus": file.bus.model_copy(update=bus),
            "api": file.api.model_copy(update=api),
            "recorder": file.recorder.model_copy(update=recorder),
            "bench": _bench(wanted, file),
        }
    )


def _bench(wanted: DemoOptions, file: Config) -> BenchSection:
    """The file's demand where it has one, with another throttle where that was asked for."""
    bench, throttle_pct = file.bench, wanted.throttle_pct
    if not wanted.has_demand:
        return bench.model_copy(update={"demand": None})
    demand = bench.demand
    if demand is None:
        demand = BenchDemandSection(
            bench_use_only=True,
            throttle_pct=_THROTTLE_PCT,
            power_mode="normal",
            speed_limit_rpm=file.limits.speed_limit_max_rpm,
        )
        bench = bench.model_copy(update={"auto_arm": True})
    if throttle_pct is not None:
        demand = demand.model_copy(update={"throttle_pct": throttle_pct})
    return bench.model_copy(update={"demand": demand})


def _scenario(wanted: DemoOptions, protocol: ProtocolSpec) -> Scenario:
    """The file's; the option wins over its battery_speedup."""
    path, speedup = wanted.scenario_path, wanted.battery_speedup
    found = Scenario(ScenarioStart(battery_speedup=_BATTERY_SPEEDUP), ())
    if path is not None:
        found = scenario.load(Path(path), protocol)
    if speedup is None:
        return found
    start = found.start.model_copy(update={"battery_speedup": speedup})
    return dataclasses.replace(found, start=start)
