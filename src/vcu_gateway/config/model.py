"""Every key of the configuration: its unit, default and range, each written once.

The last word of a number's name is its unit. The ranges, defaults and descriptions in
`vehicle` and `machine` are what `vcu-gateway schema` prints; a test holds config/gateway.yaml
to them.
"""

from dataclasses import dataclass, field

from pydantic import PrivateAttr

from vcu_gateway.config.machine import Api, Bus, Freshness, Log, Protocol
from vcu_gateway.config.value_types import Section
from vcu_gateway.config.vehicle import BenchSection, DemandSection, LimitsSection, SafetySection
from vcu_gateway.strict_yaml.lines import LineMap


@dataclass(frozen=True)
class ConfigSource:
    """The file that a configuration came from; two files that say the same are equal."""

    file: str = field(default="", compare=False)
    lines: LineMap = field(default_factory=LineMap, compare=False)


class Config(Section):
    """Configuration of vcu-gateway."""

    bus: Bus = Bus()
    protocol: Protocol = Protocol()
    freshness: Freshness = Freshness()
    limits: LimitsSection = LimitsSection()
    safety: SafetySection = SafetySection()
    demand: DemandSection = DemandSection()
    api: Api = Api()
    bench: BenchSection = BenchSection()
    log: Log = Log()

    _source: ConfigSource = PrivateAttr(default_factory=ConfigSource)

    @property
    def source(self) -> ConfigSource:
        """Where this configuration was read; an empty file name where it was not."""
        return self._source

    def remember_source(self, source: ConfigSource) -> None:
        """Keep where this was read, for errors that show later."""
        self._source = source
