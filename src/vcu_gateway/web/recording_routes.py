"""Routes of the recordings: the list, a download, the verdict of a replay, a what-if."""

import contextlib
import json
import os
import tempfile
from collections.abc import Awaitable
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from vcu_gateway.api.errors import Right
from vcu_gateway.web.access import Visitor
from vcu_gateway.web.events import WebEvents
from vcu_gateway.web.recordings import RecorderFolder, TooBusyError, VerbResult, archive
from vcu_gateway.web.routes import answer, body, problem

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
        folder = self._for(visitor)
        if isinstance(folder, Response):
            return folder
        listed = await _result(folder.listed())
        return listed if isinstance(listed, Response) else _listed(listed)

    async def download(self, request: Request, visitor: Visitor) -> Response:
        """The whole folder of one as a tar file."""
        found = self._find(request, visitor)
        if isinstance(found, Response):
            return found
        _, path = found
        self._tell("recording_downloaded", path, visitor)
        headers = {
            "content-disposition": f'attachment; filename="{path.name}.tar"',
            "cache-control": "no-store",
        }
        return StreamingResponse(archive(path), media_type="application/x-tar", headers=headers)

    async def replay(self, request: Request, visitor: Visitor) -> Response:
        found = self._find(request, visitor)
        if isinstance(found, Response):
            return found
        folder, path = found
        self._tell("recording_replayed", path, visitor)
        replayed = await _result(folder.replay(path))
        return replayed if isinstance(replayed, Response) else _said(replayed)

    async def what_if(self, request: Request, visitor: Visitor) -> Response:
        found = self._find(request, visitor)
        if isinstance(found, Response):
            return found
        folder, path = found
        config = await body(request, MOST_CONFIG_BYTES)
        if isinstance(config, Response):
            return config
        self._tell("what_if_asked", path, visitor)
        try:
            with tempfile.TemporaryDirectory(prefix="vcu-web.") as temporary:
                file = Path(temporary) / "gateway.yaml"
                file.write_bytes(config)
                replayed = await _result(folder.replay(path, file))
                hide = temporary + os.sep
        except OSError as error:
            return problem(507, f"the configuration cannot be kept: {error.strerror}")
        return replayed if isinstance(replayed, Response) else _said(replayed, hide)

    def _for(self, visitor: Visitor) -> RecorderFolder | Response:
        if not visitor.may(Right.OPERATE):
            return problem(403, "recordings tell about people: they are for operators")
        return self._folder or problem(404, _NO_FOLDER)

    def _find(self, request: Request, visitor: Visitor) -> tuple[RecorderFolder, Path] | Response:
        folder = self._for(visitor)
        if isinstance(folder, Response):
            return folder
        path = None
        with contextlib.suppress(OSError, ValueError):
            path = folder.find(request.path_params["kind"], request.path_params["name"])
        return (folder, path) if path else problem(404, "there is no such recording")

    def _tell(self, name: str, path: Path, visitor: Visitor) -> None:
        self._events.tell(name, "info", recording=path.name, **visitor.fields())


def _listed(result: VerbResult) -> Response:
    """What `recordings list` found; none, and why, where it cannot."""
    with contextlib.suppress(ValueError):
        return answer({**json.loads(result.output), "sentence": ""})
    return answer({"recordings": [], "sentence": _reason(result)})


def _said(result: VerbResult, hide: str = "") -> Response:
    """The verdict and its lines; the sentence of the error where there is none."""
    if result.code is None:
        return problem(504, "it took longer than two minutes and was ended")
    lines = result.output.decode(errors="replace").replace(hide or "\0", "").splitlines()
    if result.code not in (_SAME, _DIFFERS) or not lines:
        return problem(422, _reason(result).replace(hide or "\0", ""))
    return answer({"same": result.code == _SAME, "lines": lines})


def _reason(result: VerbResult) -> str:
    lines = result.errors.decode(errors="replace").splitlines()[-10:]
    said = "\n".join(line.removeprefix("error: ") for line in lines)
    return said or f"it ended with {result.code} and said nothing"


async def _result(running: Awaitable[VerbResult]) -> VerbResult | Response:
    """What the verb said; why it did not run, where it did not."""
    try:
        return await running
    except TooBusyError:
        return problem(429, "another one is being computed: try again soon", {"retry-after": "5"})
    except OSError as error:
        return problem(503, f"it cannot be computed now: {error.strerror}", {"retry-after": "5"})
