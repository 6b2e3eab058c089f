"""Recordings of the recorder: listed, given away as one file, and computed again.

Computing takes a processor for long, and reads files: it is done by `vcu-gateway replay`, a process
of its own with limits on time, memory and output, one at a time.
"""

import asyncio
import contextlib
import os
import re
import resource
import signal
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

WITHIN_S = 120.0
MOST_OUTPUT_BYTES = 4 * 1024 * 1024
_NICENESS = 10
_LIMITS = {
    resource.RLIMIT_CPU: int(WITHIN_S),
    resource.RLIMIT_AS: 512 * 1024 * 1024,
    resource.RLIMIT_FSIZE: 0,
    resource.RLIMIT_CORE: 0,
}
_READ_BYTES = 65_536
_KINDS = ("drives", "incidents")
_NAME = re.compile(r"[0-9]{8}T[0-9]{6}Z-[A-Za-z0-9_.-]{1,64}")


class VerbResult(NamedTuple):
    """What a verb of this program said, and how it ended; None where it took too long."""

    code: int | None
    output: bytes
    errors: bytes


class TooBusyError(Exception):
    """Another one is running."""


class RecorderFolder:
    """Folder of the recorder, read only."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._listing, self._computing = asyncio.Lock(), asyncio.Lock()

    def find(self, kind: str, name: str) -> Path | None:
        """Folder of a drive or an incident; None for a name that is none."""
        if kind not in _KINDS or _NAME.fullmatch(name) is None:
            return None
        path = self._folder / kind / name
        return path if path.is_dir() and not path.is_symlink() else None

    async def listed(self) -> VerbResult:
        arguments = ("recordings", "list", "--json", "--folder", str(self._folder))
        return await _alone(self._listing, *arguments)

    async def replay(self, path: Path, config: Path | None = None) -> VerbResult:
        """`replay` of a recording, or what another configuration would have done."""
        options = ["--config", str(config)] if config is not None else []
        return await _alone(self._computing, "replay", str(path), *options)


async def _alone(lock: asyncio.Lock, *arguments: str) -> VerbResult:
    if lock.locked():
        raise TooBusyError
    async with lock:
        return await _verb(*arguments)


async def _verb(*arguments: str) -> VerbResult:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", "vcu_gateway", *arguments),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
        env={"PATH": os.environ.get("PATH", os.defpath), "LANG": "C.UTF-8"},
    )
    _limit(process.pid)
    if process.stdout is None or process.stderr is None:
        raise AssertionError("both are pipes")
    try:
        async with asyncio.timeout(WITHIN_S):
            output, errors = await asyncio.gather(_read(process.stdout), _read(process.stderr))
            return VerbResult(await process.wait(), output, errors)
    except TimeoutError:
        return VerbResult(None, b"", b"")
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()


async def _read(stream: asyncio.StreamReader) -> bytes:
    """What it writes, cut off after 4 MiB."""
    kept = bytearray()
    while chunk := await stream.read(_READ_BYTES):
        kept += chunk[: max(0, MOST_OUTPUT_BYTES - len(kept))]
    return bytes(kept)


def _limit(pid: int) -> None:
    """Behind all others, and bounded; what the sandbox does not allow, its own limits do."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, _NICENESS)
    for limit, value in _LIMITS.items():
        with contextlib.suppress(OSError):
            resource.prlimit(pid, limit, (value, value))


def archive(path: Path) -> Iterator[bytes]:
    """The folder as a tar file, piece by piece; its members are compressed already."""
    for one in sorted(path.iterdir()):
        if one.is_file() and not one.is_symlink():
            yield from _member(one, f"{path.name}/{one.name}")
    yield bytes(2 * tarfile.BLOCKSIZE)


def _member(path: Path, name: str) -> Iterator[bytes]:
    """One file, as long as it is now: one that is being written may grow meanwhile."""
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        entry = tarfile.TarInfo(name)
        found = os.fstat(file.fileno())
        entry.size, entry.mtime = found.st_size, int(found.st_mtime)
        yield entry.tobuf(tarfile.PAX_FORMAT)
        left = entry.size
        while left and (piece := file.read(min(left, _READ_BYTES))):
            left -= len(piece)
            yield piece
        padding = left + -entry.size % tarfile.BLOCKSIZE  # the file may have become shorter, too
        while padding:
            yield bytes(min(padding, _READ_BYTES))
            padding -= min(padding, _READ_BYTES)
