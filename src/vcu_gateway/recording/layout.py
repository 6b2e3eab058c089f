"""Names and folders of recorded drives and incidents.

    drives/20261123T180412Z-1f3a9c2e/    start of the gateway by the wall clock, and of its run id
        drive.json  config.yaml  vcu.dbc
        0001.frames.log.gz  0001.core.jsonl.gz  0002.frames.log.gz  ...
    incidents/20261123T180612Z-fault_latched/
        incident.json  incident-2.json ...   one for each reason, the first and what came meanwhile
        drive.json  config.yaml  vcu.dbc     copies
        0002.frames.log.gz  ...              hard links
    keep                                     in either: the recorder never removes this folder

Files and folders are made once: nothing is written again, and nothing is renamed over.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.errors import DataError, GatewayError, MissingInputError, Problem
from vcu_gateway.files import sync
from vcu_gateway.text import utc

FORMAT = 1
DEFAULT_FOLDER = Path("/var/lib/vcu-gateway-recorder")
"""Of all recordings, where the service keeps them."""
DRIVES = "drives"
INCIDENTS = "incidents"
DRIVE_FILE = "drive.json"
CONFIG_FILE = "config.yaml"
DBC_FILE = "vcu.dbc"
FILES_BESIDE = (DRIVE_FILE, CONFIG_FILE, DBC_FILE)
INCIDENT_FILE = "incident.json"
KEEP_FILE = "keep"
REQUESTED = "requested"
"""Reason of an incident that somebody asked for."""
REASON_FILE = ".reason"
"""In the folder of incidents: why somebody asks the recorder for one of this moment."""
REASON_MAX_LENGTH = 200
MAX_SMALL_BYTES = 4 << 20
"""Of a file beside the members; a larger one is no recorder's."""

_SEGMENT = re.compile(r"(\d{4,9})(?:\.frames\.log\.gz|\.core\.jsonl\.gz)", re.ASCII)
_INCIDENT = re.compile(r"incident(?:-\d+)?\.json", re.ASCII)
_TEXTS = {"config": CONFIG_FILE, "dbc": DBC_FILE}
_PARTIAL = ".partial-"
_STAMP = "%Y%m%dT%H%M%SZ"


class SegmentFiles(NamedTuple):
    """Both files of a segment; None for one that is not there."""

    number: int
    frames: Path | None
    core: Path | None

    @property
    def paths(self) -> tuple[Path, ...]:
        return tuple(path for path in (self.frames, self.core) if path is not None)


def frames_name(number: int) -> str:
    return f"{number:04d}.frames.log.gz"


def core_name(number: int) -> str:
    """File of everything else of a segment."""
    return f"{number:04d}.core.jsonl.gz"


def drive_name(start_wall_ns: int, run: str) -> str:
    """Folder of a drive: when its gateway started, and the begin of its run id."""
    return f"{utc(start_wall_ns, _STAMP)}-{_plain(run)[:8]}"


def incident_name(wall_ns: int, reason: str) -> str:
    """Folder of an incident; another of the same second gets `-2`, `-3` behind it."""
    return f"{utc(wall_ns, _STAMP)}-{_plain(reason)}"


def free_path(folder: Path, is_own: Callable[[Path], bool] = lambda _: False) -> Path:
    """This path, or with the first of -2, -3 behind its name that is free, or the caller's own."""
    path, count = folder, 1
    while os.path.lexists(path) and not is_own(path):
        count += 1
        path = folder.with_name(f"{folder.name}-{count}")
    return path


def _plain(text: str) -> str:
    return re.sub(r"[^0-9A-Za-z_-]", "_", text)


def plain_reason(text: str) -> str:
    """A reason as one line of printable text, not too long."""
    return "".join(one if one.isprintable() else " " for one in text).strip()[:REASON_MAX_LENGTH]


def segments(folder: Path) -> list[SegmentFiles]:
    """Segments of a drive or incident folder, by number; OSError as `listdir` has it."""
    numbers = {int(found[1]) for name in os.listdir(folder) if (found := _SEGMENT.fullmatch(name))}
    return [_segment(folder, number) for number in sorted(numbers)]


def segment_number(name: str) -> int | None:
    """Number of the segment that a file of this name belongs to; None for other files."""
    found = _SEGMENT.fullmatch(name)
    return None if found is None else int(found[1])


def _segment(folder: Path, number: int) -> SegmentFiles:
    paths = (folder / frames_name(number), folder / core_name(number))
    frames, core = (path if os.path.lexists(path) else None for path in paths)
    return SegmentFiles(number, frames, core)


def recorded_folders(parent: Path) -> list[Path]:
    """Drives or incidents of this folder, by name; none where the folder is not there."""
    try:
        names = os.listdir(parent)
    except FileNotFoundError:
        return []
    paths = (parent / name for name in sorted(names) if not name.startswith("."))
    return [path for path in paths if os.path.isdir(path)]


def incident_files(folder: Path) -> list[Path]:
    """Descriptions of an incident: `incident.json`, then those of what came meanwhile."""
    names = [name for name in os.listdir(folder) if _INCIDENT.fullmatch(name)]
    return [folder / name for name in sorted(names, key=lambda name: (len(name), name))]


def read_small(path: Path) -> bytes:
    """A file beside the members; OSError also where it is no regular file, or too large."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "is no regular file", str(path))
        data = file.read(MAX_SMALL_BYTES + 1)
    if len(data) > MAX_SMALL_BYTES:
        raise OSError(errno.EFBIG, f"is larger than {MAX_SMALL_BYTES >> 20} MiB", str(path))
    return data


def read_description(path: Path) -> dict[str, Any]:
    """A drive.json or incident.json; MissingInputError or DataError where it cannot be used."""
    try:
        described = json.loads(read_small(path))
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        remedy = "give the folder of a drive or an incident"
        raise MissingInputError(Problem(what, str(path), remedy)) from error
    except (ValueError, RecursionError) as error:
        raise DataError(Problem(f"is no JSON: {error}", str(path))) from error
    if not isinstance(described, dict) or type(described.get("format")) is not int:
        raise DataError(Problem("has no format number", str(path)))
    if described["format"] > FORMAT:
        what = f"has format {described['format']}, and this version reads up to {FORMAT}"
        raise DataError(Problem(what, str(path), "read it with a newer vcu-gateway"))
    return described


def description_if_any(path: Path) -> dict[str, Any]:
    """A drive.json or incident.json; empty where it cannot be used."""
    try:
        return read_description(path)
    except GatewayError:
        return {}


def description_bytes(described: Mapping[str, Any]) -> bytes:
    """JSON text of a description, for people too."""
    return json.dumps(described, indent=2, sort_keys=True).encode() + b"\n"


def drive_files(hello: Mapping[str, Any], **more: Any) -> dict[str, bytes]:
    """Files of a new drive: what its gateway said of itself, with more beside, and both texts."""
    described = {key: value for key, value in hello.items() if key not in _TEXTS}
    texts = {name: str(hello[key]).encode() for key, name in _TEXTS.items()}
    return {DRIVE_FILE: description_bytes(described | more), **texts}


def incident_bytes(
    incident: Mapping[str, Any],
    drive: Mapping[str, Any],
    links: Iterable[Path],
    copies: Mapping[str, bytes],
) -> bytes:
    """JSON text of an incident.json: with its segments, its copies' digests and its own digest.

    `drive`: the description of its drive, which it says its run, channel and configuration of.
    """
    found = [segment_number(path.name) for path in links]
    numbers = [number for number in found if number is not None]
    described = {
        **incident,
        **{key: drive.get(key) for key in ("run", "channel", "config_digest")},
        "format": FORMAT,
        "segments": [min(numbers), max(numbers)] if numbers else None,
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in copies.items()},
    }
    return description_bytes({**described, "digest": description_digest(described)})


def description_digest(described: Mapping[str, Any]) -> str:
    """SHA-256 of an incident's description, without what it says of that itself."""
    rest = {key: value for key, value in described.items() if key != "digest"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_new(path: Path, data: bytes) -> None:
    """Make a file that was not there, and have it on the disk."""
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def link_files(paths: Iterable[Path], folder: Path) -> None:
    """Make hard links in a folder, but of what it has already."""
    for path in paths:
        with contextlib.suppress(FileExistsError):
            os.link(path, folder / path.name)


def create_folder(folder: Path, files: Mapping[str, bytes], links: Iterable[Path] = ()) -> None:
    """Make a folder with files and hard links in it, all of it or nothing, on the disk.

    FileExistsError where it is there already; other OSError as the disk has them. What a crash
    leaves behind begins with `.partial-`.
    """
    partial = folder.with_name(_PARTIAL + folder.name)
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(mode=0o750, parents=True)
    try:
        for name, data in files.items():
            write_new(partial / name, data)
        for path in links:
            with contextlib.suppress(FileNotFoundError):  # somebody removed it
                os.link(path, partial / path.name)
        sync(partial)
        if os.path.lexists(folder):
            raise FileExistsError(folder)
        partial.rename(folder)
    except OSError:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    sync(folder.parent)


def remove_partial_folders(parent: Path) -> None:
    for path in parent.glob(f"{_PARTIAL}*"):
        shutil.rmtree(path, ignore_errors=True)


FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def hold(folder: Path) -> int:
    """Mark it as being written, until the descriptor is closed, or the process ends however."""
    descriptor = os.open(folder, FOLDER_FLAGS)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor


def is_held(folder: Path) -> bool:
    """True where a process writes into it; OSError where the folder cannot be opened."""
    descriptor = os.open(folder, FOLDER_FLAGS)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False
