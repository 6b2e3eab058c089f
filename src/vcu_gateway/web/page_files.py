"""Files of the page, read and compressed once at the start; nothing else of the disk is served."""

import gzip
import hashlib
from collections.abc import Mapping
from importlib import resources
from pathlib import PurePath
from typing import NamedTuple, Self

from starlette.requests import Request
from starlette.responses import Response

_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


class EncodedBody(NamedTuple):
    """Body of an answer, as it is and packed by gzip."""

    content_type: str
    plain: bytes
    packed: bytes

    @classmethod
    def of(cls, content_type: str, plain: bytes) -> Self:
        return cls(content_type, plain, gzip.compress(plain, mtime=0))

    def response(self, request: Request, headers: Mapping[str, str]) -> Response:
        """The form that the browser takes."""
        headers, body = {**headers, "vary": "accept-encoding"}, self.plain
        if "gzip" in request.headers.get("accept-encoding", ""):
            headers["content-encoding"], body = "gzip", self.packed
        return Response(body, headers=headers, media_type=self.content_type)


class PageFile(NamedTuple):
    """One file; its tag changes with it."""

    body: EncodedBody
    tag: str

    async def response(self, request: Request) -> Response:
        """The file, or 304 where the browser has it; it is the handler of its path."""
        headers = {"etag": self.tag, "cache-control": "no-cache", "vary": "accept-encoding"}
        if request.headers.get("if-none-match") == self.tag:
            return Response(status_code=304, headers=headers)
        return self.body.response(request, headers)


def page_files() -> dict[str, PageFile]:
    """Every file by its path on the server; / is the page."""
    package = resources.files("vcu_gateway")
    files = {f"/{one.name}": one for one in (package / "web" / "page").iterdir()}
    # The one copy of uPlot and of how plots are drawn; the package they lie in is not imported.
    export = package / "export"
    files |= {f"/uplot/{one.name}": one for one in (export / "uplot").iterdir()}
    files["/plots.js"] = export / "page" / "plots.js"
    files["/"] = files.pop("/index.html")
    return {
        path: _page_file(one.read_bytes(), _TYPES[ending])
        for path, one in files.items()
        if (ending := PurePath(one.name).suffix) in _TYPES
    }


def _page_file(plain: bytes, content_type: str) -> PageFile:
    tag = hashlib.sha256(plain).hexdigest()[:16]
    return PageFile(EncodedBody.of(content_type, plain), f'"{tag}"')
