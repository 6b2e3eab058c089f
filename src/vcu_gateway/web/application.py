"""The page as an ASGI application: settings -> link, access, routes, guard."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp

from vcu_gateway.web import certificate
from vcu_gateway.web.access import Access
from vcu_gateway.web.actions import Actions
from vcu_gateway.web.broadcast import Broadcast
from vcu_gateway.web.events import WebEvents
from vcu_gateway.web.gateway_link import GatewayLink
from vcu_gateway.web.guard import Guard
from vcu_gateway.web.page_files import PageFile, page_files
from vcu_gateway.web.recording_routes import RecordingRoutes
from vcu_gateway.web.routes import Routes
from vcu_gateway.web.settings import WebSettings
from vcu_gateway.web.stream import Streams


def build(settings: WebSettings, events: WebEvents) -> ASGIApp:
    """The whole application; its lifespan follows the gateway."""
    broadcast = Broadcast()
    link = GatewayLink(settings.socket_path, broadcast, events)
    events.on_change = link.answers.note_event
    actions = Actions(settings.socket_path)
    access = Access(settings, events)
    api = Routes(access, link, actions, Streams(broadcast), events)
    recordings = RecordingRoutes(settings.recordings, events)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(link.run()), *_certificate_watch(settings, link)]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await actions.close()
            await link.close()

    routes = [*_api_routes(api, recordings), *_file_routes(page_files())]
    starlette = Starlette(routes=routes, lifespan=lifespan)
    starlette.router.redirect_slashes = False  # a path is one of the routes, or none
    return Guard(starlette, settings)


def _certificate_watch(settings: WebSettings, link: GatewayLink) -> list[asyncio.Task[None]]:
    if settings.tls is None:
        return []
    with contextlib.suppress(OSError, ValueError):  # TLS itself has taken it, or said why not
        end = certificate.end_of(settings.tls.certificate)
        return [asyncio.create_task(certificate.watch(end, link.tell_certificate))]
    return []


def _api_routes(api: Routes, recordings: RecordingRoutes) -> list[Route]:
    visitors = api.for_visitors
    return [
        Route("/api/session", api.session, methods=["GET"]),
        Route("/api/session", api.sign_in, methods=["POST"]),
        Route("/api/session", api.sign_out, methods=["DELETE"]),
        Route("/api/clock", visitors(api.clock)),
        Route("/api/stream", visitors(api.stream)),
        Route("/api/history", visitors(api.history)),
        Route("/api/actions/{name}", api.act, methods=["POST"]),
        Route("/api/recordings", visitors(recordings.listed)),
        Route("/api/recordings/{kind}/{name}/download", visitors(recordings.download)),
        Route(
            "/api/recordings/{kind}/{name}/replay", visitors(recordings.replay), methods=["POST"]
        ),
        Route(
            "/api/recordings/{kind}/{name}/what-if", visitors(recordings.what_if), methods=["POST"]
        ),
    ]


def _file_routes(files: dict[str, PageFile]) -> list[Route]:
    return [Route(path, _file_handler(file)) for path, file in files.items()]


def _file_handler(file: PageFile) -> Callable[[Request], Awaitable[Response]]:
    async def handler(request: Request) -> Response:
        return file.response(request)

    return handler
