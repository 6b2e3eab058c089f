"""Recordings of the recorder: listed, given away as one file, and computed again.

Computing takes a processor for long, and reads files: it is done by `vcu-gateway replay`, a process
of its own with limits on time, memory and output, one at a time.

Routes of the recordings: the list, a download, the verdict of a replay, a what-if.
"""

import asyncio
import contextlib
import json
import os
import re
import resource
import signal
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from vcu_gateway.api.errors import Right
from vcu_gateway.web.access import Visitor
from vcu_gateway.web.guard import NO_STORE, PageRequestError
from vcu_gateway.web.routes import answer, body
from vcu_gateway.web.users import WebEvents

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
_LATER = {"retry-after": "5"}
_KINDS = ("drives", "incidents")
_NAME = re.compile(r"[0-9]{8}T[0-9]{6}Z-[A-Za-z0-9_.-]{1,64}")


class VerbResult(NamedTuple):
    """What a verb of this program said, and how it ended; None where it took too long."""

    code: int | None
    output: bytes
    errors: bytes


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

    async def replay(self, path: Path, *options: str) -> VerbResult:
        """`replay` of a recording; with --config, what another configuration would have done."""
        return await _alone(self._computing, "replay", str(path), *options)


async def _alone(lock: asyncio.Lock, *arguments: str) -> VerbResult:
    """What the verb said; PageRequestError where another one runs, or it cannot run."""
    if lock.locked():
        raise PageRequestError(429, "another one is being computed: try again soon", _LATER)
    try:
        async with lock:
            return await _verb(*arguments)
    except OSError as error:
        sentence = f"it cannot be computed now: {error.strerror}"
        raise PageRequestError(503, sentence, _LATER) from error


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


MOST_CONFIG_BYTES = 64 * 1024

_NO_FOLDER = "no recorder's folder is known here (--recordings)"
_SAME, _DIFFERS = 0, 1


class RecordingRoutes:
    """What a recording tells about a person is for operators (docs/recordings.md)."""

    def __init__(self, folder: Path | None, events: WebEvents) -> None:
        self._folder = RecorderFolder(folder) if folder is not None else None
        self._events = events

    async def listed(self, request: Request, visitor: Visitor) -> Response:
        """Drives and incidents; none, and why, where there is no recorder."""
        del request
        if self._folder is None and visitor.may(Right.OPERATE):
            return answer({"recordings": [], "sentence": _NO_FOLDER})
        return _listed(await self._for(visitor).listed())

    async def download(self, request: Request, visitor: Visitor) -> Response:
        """The whole folder of one as a tar file."""
        _, path = self._find(request, visitor)
        self._tell("recording_downloaded", path, visitor)
        headers = {"content-disposition": f'attachment; filename="{path.name}.tar"', **NO_STORE}
        return StreamingResponse(archive(path), media_type="application/x-tar", headers=headers)

    async def replay(self, request: Request, visitor: Visitor) -> Response:
        folder, path = self._find(request, visitor)
        self._tell("recording_replayed", path, visitor)
        return _said(await folder.replay(path))

    async def what_if(self, request: Request, visitor: Visitor) -> Response:
        folder, path = self._find(request, visitor)
        config = await body(request, MOST_CONFIG_BYTES)
        self._tell("what_if_asked", path, visitor)
        try:
            with tempfile.TemporaryDirectory(prefix="vcu-web.") as temporary:
                file = Path(temporary) / "gateway.yaml"
                file.write_bytes(config)
                return _said(await folder.replay(path, "--config", str(file)), temporary + os.sep)
        except OSError as error:
            sentence = f"the configuration cannot be kept: {error.strerror}"
            raise PageRequestError(507, sentence) from error

    def _for(self, visitor: Visitor) -> RecorderFolder:
        """The folder; PageRequestError for who may not see it, and where there is none."""
        if not visitor.may(Right.OPERATE):
            sentence = "recordings tell about people: they are for operators"
            raise PageRequestError(403, sentence)
        if self._folder is None:
            raise PageRequestError(404, _NO_FOLDER)
        return self._folder

    def _find(self, request: Request, visitor: Visitor) -> tuple[RecorderFolder, Path]:
        folder, path = self._for(visitor), None
        with contextlib.suppress(OSError, ValueError):
            path = folder.find(request.path_params["kind"], request.path_params["name"])
        if path is None:
            raise PageRequestError(404, "there is no such recording")
        return folder, path

    def _tell(self, name: str, path: Path, visitor: Visitor) -> None:
        self._events.tell(name, "info", recording=path.name, **visitor.fields())


def _listed(result: VerbResult) -> Response:
    """What `recordings list` found; none, and why, where it cannot."""
    with contextlib.suppress(ValueError):
        return answer({**json.loads(result.output), "sentence": ""})
    return answer({"recordings": [], "sentence": _reason(result)})


def _said(result: VerbResult, hide: str = "\0") -> Response:
    """The verdict and its lines; the sentence of the error where there is none."""
    if result.code is None:
        raise PageRequestError(504, "it took longer than two minutes and was ended")
    lines = result.output.decode(errors="replace").replace(hide, "").splitlines()
    if result.code not in (_SAME, _DIFFERS) or not lines:
        raise PageRequestError(422, _reason(result).replace(hide, ""))
    return answer({"same": result.code == _SAME, "lines": lines})


def _reason(result: VerbResult) -> str:
    lines = result.errors.decode(errors="replace").splitlines()[-10:]
    said = "\n".join(line.removeprefix("error: ") for line in lines)
    return said or f"it ended with {result.code} and said nothing"
