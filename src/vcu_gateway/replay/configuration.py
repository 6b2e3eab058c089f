"""Configuration and DBC of a replay: the recorded ones, another file, single keys set otherwise."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway import config as configuration
from vcu_gateway.config.tuning import TUNING_SECTIONS
from vcu_gateway.core.settings import KEYS, Settings
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import ConfigError, Problem
from vcu_gateway.strict_yaml import file_text, parser

SET = "--set"
_EXAMPLE = "write section.key=value, such as limits.throttle_slew_pct_per_s=50"
_USED_SECTIONS = {key.section for key in KEYS.values()} | {"bench", "pedals", *TUNING_SECTIONS}


class GivenConfiguration(NamedTuple):
    """Configuration of a replay.

    Attributes:
        aliases: further identifiers of messages.
        without_effect: what of it a replay does not use, as sentences.
    """

    settings: Settings
    aliases: Mapping[int, str]
    without_effect: tuple[str, ...]


class Changes(NamedTuple):
    """What if: the file of another configuration, and keys to be set, as "section.key=value"."""

    config_path: Path | None = None
    assignments: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Everything that is given; empty where nothing is."""
        path = self.config_path
        return [*([] if path is None else [str(path)]), *self.assignments]

    def configuration(
        self, text: str | None, where: str, protocol: ProtocolSpec
    ) -> GivenConfiguration:
        """The text, or the other file in its place, with the keys set; None: every default.

        Its DBC is left out: a recording is decoded with its own. ConfigError names each error.
        """
        if self.config_path is not None:
            text, where = file_text.read(self.config_path), str(self.config_path)
        document = parser.read(text or "")
        if not document.is_yaml or not isinstance(document.value, dict | None):
            configuration.of_document(document, where)  # which says what is wrong
        values: dict[str, Any] = dict(document.value or {})
        without_effect = _drop_dbc(values)
        for assignment in self.assignments:
            path, x, value = _assignment(assignment)
            if x is not None:
                value = _with_point(_at(values, path), x, value)
            _put(values, path, value)
            if path[0] not in _USED_SECTIONS or path[:2] == ("protocol", "status_code_names"):
                without_effect.append(f"{'.'.join(path)} has no effect on what is decided")
        if self.assignments or text is None:
            config = configuration.of_values(values, SET if self.assignments else where)
        else:  # its problems have their lines
            document = document._replace(value=document.value and values)
            config = configuration.of_document(document, where)
        if problems := configuration.check_against(config, protocol):
            raise ConfigError(*problems)
        settings = configuration.core_settings(config)
        return GivenConfiguration(settings, config.protocol.aliases, tuple(without_effect))


def _drop_dbc(values: dict[str, Any]) -> list[str]:
    section = values.get("protocol")
    if not isinstance(section, dict) or section.get("dbc") is None:
        return []
    values["protocol"] = {key: value for key, value in section.items() if key != "dbc"}
    return ["protocol.dbc is not used: a recording is decoded with the DBC recorded beside it"]


def _with_point(points: Any, x_text: str, y: Any) -> Any:
    """The points of a curve with one at this x; what is no curve is left to be refused."""
    try:
        x = float(x_text)
    except ValueError:
        remedy = "write @x=y, such as @110=6000"
        raise ConfigError(Problem(f"'...@{x_text}' is no point", SET, remedy)) from None
    try:
        others = [list(point) for point in points or () if float(point[0]) != x]
        return sorted([*others, [x, y]], key=lambda point: float(point[0]))
    except (TypeError, ValueError, LookupError):
        return points


def _at(values: Mapping[str, Any], path: tuple[str, ...]) -> Any:
    """The value of a key; None where there is none."""
    place: Any = values
    for name in path:
        place = place.get(name) if isinstance(place, dict) else None
    return place


def _assignment(assignment: str) -> tuple[tuple[str, ...], str | None, Any]:
    """Key, the x of a curve's point where one is meant, and value."""
    name, equals, text = assignment.partition("=")
    name, at, x_text = name.partition("@")
    *parents, last = (part.strip() for part in name.split("."))
    path = (*parents, f"{last}{at}{x_text.strip()}")
    if not equals or len(path) < 2 or not all(path):
        key = KEYS.get(path[0])
        remedy = _EXAMPLE if key is None else f'did you mean "{key.section}.{assignment}"?'
        raise ConfigError(Problem(f"{assignment!r} sets nothing", SET, remedy))
    read = parser.read(f"value: {text}")
    if read.findings:
        finding = read.findings[0]
        what = f"{name}: the value {text!r} {finding.what}"
        raise ConfigError(Problem(what, SET, finding.remedy))
    return (*parents, last), x_text.strip() if at else None, read.value["value"]


def _put(values: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    """Set a key of a section, or of a mapping in it; the values given are not changed below."""
    *parents, key = path
    place = values
    for name in parents:
        below = place.get(name)
        place[name] = dict(below) if isinstance(below, dict) else {}
        place = place[name]
    place[key] = value
