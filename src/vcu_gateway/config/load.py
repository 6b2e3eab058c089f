"""A configuration file -> Config, or every reason why not."""

import codecs
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from pydantic import ValidationError

from vcu_gateway.config import document, shape
from vcu_gateway.config.findings import Finding, problems
from vcu_gateway.config.model import Config, Source
from vcu_gateway.errors import ConfigError, Problem

_LARGEST_BYTES = 1 << 20
_BYTE_ORDER_MARK = "\ufeff"

_UNREADABLE = {
    errno.ENOENT: "there is no such file",
    errno.ENOTDIR: "there is no such file",
    errno.EISDIR: "is a directory, not a file",
    errno.ELOOP: "is a symbolic link that leads back to itself",
    errno.EACCES: "this user may not read it",
    errno.EPERM: "this user may not read it",
}

# The bench demand's own limits and what they must not exceed.
_DEMAND_LIMITS = {
    "speed_limit_rpm": "speed_limit_max_rpm",
    "power_limit_w": "power_limit_max_w",
}


def load(path: Path) -> Config:
    """Read a configuration file; ConfigError names everything that is wrong with it."""
    return parse(_text(_contents(path), str(path)), str(path))


def _contents(path: Path) -> bytes:
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "")
        if not stat.S_ISREG(mode):
            raise ConfigError(Problem("is no regular file", str(path)))
        with path.open("rb") as file:
            contents = file.read(_LARGEST_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ConfigError(Problem(_why_unreadable(error), str(path))) from error
    if len(contents) > _LARGEST_BYTES:
        raise ConfigError(Problem("is larger than 1 MiB: no configuration", str(path)))
    return contents


def _why_unreadable(error: OSError | ValueError) -> str:
    if isinstance(error, OSError) and error.errno in _UNREADABLE:
        return _UNREADABLE[error.errno]
    return f"cannot be read: {error}"


def _text(contents: bytes, where: str) -> str:
    if contents.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ConfigError(Problem("is UTF-16 text", where, "save it as UTF-8"))
    if b"\0" in contents:
        raise ConfigError(Problem("is binary, not text", where))
    try:
        return contents.decode()
    except UnicodeDecodeError as error:
        line = contents.count(b"\n", 0, error.start) + 1
        what = f"is not UTF-8 text: byte 0x{contents[error.start]:02X}"
        raise ConfigError(Problem(what, f"{where}:{line}", "save it as UTF-8")) from error


def parse(text: str, where: str) -> Config:
    """As `load`, from text; `where` is the file that errors name and paths are relative to."""
    read = document.read(text.removeprefix(_BYTE_ORDER_MARK))
    if read.is_yaml and read.value is None and not read.findings:
        remedy = "write at least one section, such as `bus:` with `channel: can0` below it"
        raise ConfigError(Problem("is empty", where, remedy))
    config, findings = _config(read)
    if config is not None and not findings:
        config = _resolved(config, Path(where).parent)
        findings += _contradictions(config)
    if config is None or findings:
        raise ConfigError(*problems(findings, where, read.lines))
    config.remember_source(Source(where, read.lines))
    return config


def _config(read: document.Document) -> tuple[Config | None, list[Finding]]:
    findings = list(read.findings)
    if not read.is_yaml:
        return None, findings
    known = {finding.path for finding in findings}
    try:
        return Config.model_validate(read.value), findings
    except ValidationError as error:
        return None, findings + [f for f in shape.findings(error) if f.path not in known]


def _resolved(config: Config, folder: Path) -> Config:
    """The effective values: the DBC's whole path, and the maxima where a demand has no limit."""
    update: dict[str, object] = {}
    dbc = config.protocol.dbc
    if dbc is not None:
        update["protocol"] = config.protocol.model_copy(update={"dbc": folder.absolute() / dbc})
    demand = config.bench.demand
    if demand is not None:
        unset = _DEMAND_LIMITS.keys() - demand.model_fields_set
        limits = {name: getattr(config.limits, _DEMAND_LIMITS[name]) for name in unset}
        update["bench"] = config.bench.model_copy(
            update={"demand": demand.model_copy(update=limits)}
        )
    return config.model_copy(update=update)


def _contradictions(config: Config) -> Iterator[Finding]:
    """What each key allows and two of them, or the files on disk, do not."""
    dbc = config.protocol.dbc
    if dbc is not None and not os.path.isfile(dbc):
        yield Finding(("protocol", "dbc"), f"no file can be found at {dbc}")
    demand = config.bench.demand
    for name, maximum in _DEMAND_LIMITS.items() if demand is not None else ():
        asked, largest = getattr(demand, name), getattr(config.limits, maximum)
        if asked > largest:
            what = f"must be at most {largest} {shape.unit(name)}, not {asked}"
            remedy = f"limits.{maximum} says so"
            yield Finding(("bench", "demand", name), what, remedy)
