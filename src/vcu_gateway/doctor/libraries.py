"""Libraries that the program does not need: their cost for the gateway and other programs."""

import importlib.metadata
import importlib.util
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Unreadable

SUBJECT = CheckSubject("libraries")
_PROGRAM = "vcu-gateway"
_LEAST_FOREIGN_MS = 20.0
_TIMEOUT_S = 60.0
# What else the gateway's process has imported: the top of each module's name, and its file.
_GATEWAY = """
import json, sys, sysconfig, vcu_gateway.cli.run
standard = sysconfig.get_path("stdlib"), "site-packages", "dist-packages"
found = {}
for name, module in list(sys.modules.items()):
    file = getattr(module, "__file__", None) or ""
    own = file.startswith(standard[0]) and not any(part in file for part in standard[1:])
    if file and not own and name.partition(".")[0] not in sys.stdlib_module_names:
        found[name.partition(".")[0]] = file
print(json.dumps(found))
"""
_PYTHON_CAN = """
import sys, time
if {hide}: sys.modules["asammdf"] = None
began_s = time.process_time()
import can
took_s = time.process_time() - began_s
held = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(took_s * 1000, int(held["VmHWM"].split()[0]) / 1024)
"""
_SECOND_ENVIRONMENT = "pip uninstall asammdf; vcu-gateway[mf4] belongs into a second environment"
_IMPORT_TIME = re.compile(r"import time: +(\d+) \| +\d+ \| +([\w.]+)")


class ImportCost(NamedTuple):
    """Cost of an import: processor time and memory."""

    time_ms: float
    memory_mb: float


class ForeignLibrary(NamedTuple):
    """Library in the gateway's process that it does not require; `file` is empty for a package."""

    time_ms: float
    file: str = ""


class LibraryFacts(NamedTuple):
    """Facts about libraries.

    Attributes:
        asammdf: its part of `import can` in other programs; None where it is not installed.
        foreign: by distribution name or, without one, by module name.
    """

    asammdf: ImportCost | Unreadable | None
    foreign: Mapping[str, ForeignLibrary] | Unreadable


def read() -> LibraryFacts:
    """Measure imports in child processes."""
    return LibraryFacts(_asammdf(), _foreign())


def _asammdf() -> ImportCost | Unreadable | None:
    if importlib.util.find_spec("asammdf") is None:
        return None
    try:
        beside, alone = (_python_can(hide) for hide in (False, True))
    except (OSError, subprocess.SubprocessError) as error:
        return Unreadable(f"import can: {error}")
    return ImportCost(beside.time_ms - alone.time_ms, beside.memory_mb - alone.memory_mb)


def _python_can(hide: bool) -> ImportCost:
    """The cheaper of two runs: the first may have waited for the disk."""
    program = _PYTHON_CAN.format(hide=hide)
    runs = [ImportCost(*map(float, _child("-c", program).stdout.split())) for _ in range(2)]
    return min(runs)


def _foreign() -> dict[str, ForeignLibrary] | Unreadable:
    try:
        child = _child("-X", "importtime", "-c", _GATEWAY)
    except (OSError, subprocess.SubprocessError) as error:
        return Unreadable(f"import vcu_gateway: {error}")
    took_us: Counter[str] = Counter()
    for duration_us, module in _IMPORT_TIME.findall(child.stderr):
        took_us[module.partition(".")[0]] += int(duration_us)
    packages, own = importlib.metadata.packages_distributions(), _own_packages()
    foreign: dict[str, ForeignLibrary] = {}
    for module, file in json.loads(child.stdout).items():
        name, *others = packages.get(module, [module])
        if own.isdisjoint(map(_normal, (name, *others))):
            before_ms = foreign[name].time_ms if name in foreign else 0.0
            own_file = "" if module in packages else file
            foreign[name] = ForeignLibrary(before_ms + took_us[module] / 1000, own_file)
    return foreign


def _child(*arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-P", *arguments]
    return subprocess.run(  # noqa: S603 - our own Python and program
        command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=True
    )


def _own_packages() -> set[str]:
    """The program, what it needs, and what its extras need; of others no extras."""
    own, waiting = set[str](), [_PROGRAM]
    while waiting:
        name = waiting.pop()
        if name in own:
            continue
        own.add(name)
        waiting += (
            _normal(re.split(r"[^\w.-]", needed, maxsplit=1)[0])
            for needed in _requirements(name)
            if name == _PROGRAM or "extra ==" not in needed
        )
    return own


def _requirements(name: str) -> list[str]:
    try:
        return importlib.metadata.requires(name) or []
    except importlib.metadata.PackageNotFoundError:  # for another system, or an extra
        return []


def _normal(name: str) -> str:
    """Normalised name of a distribution (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def judge(facts: LibraryFacts) -> Iterator[CheckResult]:
    yield from _in_the_gateway(facts.foreign)
    found = facts.asammdf
    if isinstance(found, Unreadable):
        yield SUBJECT.unknown("asammdf", found.reason)
    elif found is not None:
        what = "asammdf stands beside the gateway, which keeps it out of its own process; in every"
        what += f" other program it makes `import can` {found.time_ms:.0f} ms longer and"
        what += f" {found.memory_mb:.0f} MB larger"
        yield SUBJECT.warning("asammdf", what, _SECOND_ENVIRONMENT)


def _in_the_gateway(foreign: Mapping[str, ForeignLibrary] | Unreadable) -> Iterator[CheckResult]:
    if isinstance(foreign, Unreadable):
        yield SUBJECT.unknown("stray", foreign.reason)
        return
    slow = {name: one for name, one in foreign.items() if one.time_ms >= _LEAST_FOREIGN_MS}
    if not slow:
        yield SUBJECT.ok("well", "nothing but its own libraries delays the gateway's start")
    for name, one in sorted(slow.items()):
        what = f"{name} is imported into the gateway without need: {one.time_ms:.0f} ms a start"
        remedy = f"pip uninstall {name}, where nothing else needs it"
        if one.file:
            remedy = f"take {one.file} out of this Python's path"
        yield SUBJECT.warning("stray", what, remedy)
