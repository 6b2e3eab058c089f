"""Scenario: faults and their times, read from a file as strictly as the configuration."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import ConfigError, Problem, did_you_mean
from vcu_gateway.simulator.faults import FaultInterval, Report
from vcu_gateway.simulator.steps import FAULTS, PROTOCOL, Step
from vcu_gateway.simulator.vehicle import RESISTANCE_OHM
from vcu_gateway.strict_yaml import file_text, parser, validation
from vcu_gateway.strict_yaml.file_text import FileProblem, KeyPath, problems, shown
from vcu_gateway.strict_yaml.validation import Section
from vcu_gateway.units import NS_PER_S

_EXAMPLE = "{at_s: 10, fault: silence, of: BMS}"


class ScenarioStart(Section):
    """The vehicle at the beginning."""

    soc_pct: float = Field(default=80.0, ge=0, le=100, description="State of charge.")
    battery_speedup: float = Field(
        default=1.0,
        ge=0,
        le=10_000,
        description="Charge flows so many times as fast as it really would.",
    )
    battery_resistance_ohm: float = Field(
        default=RESISTANCE_OHM, ge=0.001, le=0.5, description="Of the pack, from end to end."
    )


class _File(Section):
    """Scenario as it is written; its steps are validated one by one."""

    start: ScenarioStart = ScenarioStart()
    steps: list[Any] = Field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Scenario:
    """Start of the vehicle and the faults in time."""

    start: ScenarioStart
    steps: tuple[Step, ...]

    def faults(
        self, codec: Codec, start_ns: int, report: Report = lambda _: None
    ) -> list[FaultInterval]:
        """Faults for `Nodes`; `report` is called when each step begins and ends."""
        return [_interval(step, codec, start_ns, report) for step in self.steps]


def _interval(step: Step, codec: Codec, start_ns: int, report: Report) -> FaultInterval:
    begin_ns = start_ns + round(step.at_s * NS_PER_S)
    end_ns = None if step.for_s is None else begin_ns + round(step.for_s * NS_PER_S)
    return FaultInterval(step.sentence(), step.broken(codec), begin_ns, end_ns, report)


def load(path: Path, protocol: ProtocolSpec) -> Scenario:
    """Read a scenario; ConfigError names everything that is wrong with it."""
    return parse(file_text.read(path), str(path), protocol)


def parse(contents: str, where: str, protocol: ProtocolSpec) -> Scenario:
    """As `load`, from text; `where` is the file that errors name."""
    read = parser.read(contents)
    if read.is_yaml and not isinstance(read.value, dict):
        remedy = f"write `steps:` and below it lines such as `- {_EXAMPLE}`"
        raise ConfigError(Problem("is no scenario", where, remedy))
    outline, found = validation.validated(_File, read.value if read.is_yaml else {})
    steps: list[Step] = []
    written = read.value.get("steps") if read.is_yaml else None
    for index, value in enumerate(written if isinstance(written, list) else ()):
        step, wrong = _step(value, ("steps", index), protocol)
        found += wrong
        steps += [step] if step else []
    known = {finding.path for finding in read.findings}
    found = [*read.findings, *(finding for finding in found if finding.path not in known)]
    if outline is None or found:
        raise ConfigError(*problems(found, where, read.lines))
    return Scenario(outline.start, tuple(steps))


def _step(value: Any, at: KeyPath, protocol: ProtocolSpec) -> tuple[Step | None, list[FileProblem]]:
    names = ", ".join(FAULTS)
    if not isinstance(value, dict):
        return None, [FileProblem(at, f"must be a step such as {_EXAMPLE}, not {shown(value)}")]
    if "fault" not in value:
        return None, [FileProblem(at, "has no fault", f"add `fault:` and one of {names}")]
    fault = value["fault"]
    if not isinstance(fault, str) or fault not in FAULTS:
        what = f"must be one of {names}, not {shown(fault)}"
        return None, [FileProblem((*at, "fault"), what, did_you_mean(str(fault), FAULTS))]
    step, refused = validation.validated(FAULTS[fault], value, {PROTOCOL: protocol})
    return step, [finding._replace(path=(*at, *finding.path)) for finding in refused]
