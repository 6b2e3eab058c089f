"""Composition root: configuration -> gateway, bus connection, tick loop and API server.

The command line, the demo and the tests put the program together here and nowhere else.
"""

import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path

from vcu_gateway import config as configuration
from vcu_gateway.api.errors import Policy
from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.config import Config, core_settings
from vcu_gateway.config.checks import dbc_path
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.daemon.log import log_event
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.reload import Reloader
from vcu_gateway.daemon.restart_state import (
    KeptDriveMode,
    RestartState,
    folder_for,
    other_folders,
)
from vcu_gateway.daemon.systemd import ServiceReporter, SystemdNotifier
from vcu_gateway.daemon.tap_socket import RecorderTap
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.recording.tap import Tap, TappedGateway
from vcu_gateway.server import queries
from vcu_gateway.server.dispatch import Dispatcher
from vcu_gateway.server.server import Server
from vcu_gateway.server.service import ServerSettings
from vcu_gateway.server.tick_gaps import TickGaps
from vcu_gateway.server.views import definition


class Application:
    """The whole program of one configuration; neither bus nor API is open yet.

    The accounts that the configuration names exist. `log_lines_dropped` counts the lines that the
    log has lost so far.

    Attributes:
        loop: gateway and bus, ticked on the thread that calls `run`.
        api: answers from its `open` to its `close`.
        facts: of this run; `start` is None until `begin_service` has counted it.
    """

    def __init__(
        self,
        config: Config,
        protocol: ProtocolSpec,
        log_lines_dropped: Callable[[], int] = lambda: 0,
    ) -> None:
        dbc = dbc_path(config).read_bytes()
        digest = hashlib.sha256(dbc).hexdigest()[:16]
        self.loop = _tick_loop(config, protocol)
        self.loop.event_log.subscribe(log_event)
        self.facts = queries.RunFacts(digest, None, log_lines_dropped)
        self.api = ApiRunner(config, protocol, self.loop, self.facts)
        self.loop.add_observer(self.api.observe)
        self._service: ServiceReporter | None = None
        self._tap: RecorderTap | None = None
        gateway, path = self.loop.gateway, config.recorder.socket_path
        if path is not None and isinstance(gateway, TappedGateway):
            self._tap = self.facts.tap = RecorderTap(
                Path(path), gateway, self.loop, self.api.reloader, digest
            )
            self.loop.add_observer(self._tap.observe)

    def begin_service(self, manager: SystemdNotifier, runtime: Path | None) -> None:
        """Take over what the last run left, keep it for the next one, report to the manager.

        The interface's lock is held: two gateways must not write the same files. `runtime` is the
        service's RuntimeDirectory; None: starts are not counted and no safe frames are kept.
        """
        if self._tap is not None:
            self._tap.begin()
        bus = self.loop.connection.settings
        folder = folder_for(bus, runtime)
        others = other_folders(bus, folder)
        restart_state = RestartState(folder, bus, self.loop.gateway, self.loop.event_log, others)
        restart_state.begin()
        gateway, event_log = self.loop.gateway, self.loop.event_log
        if (kept := KeptDriveMode.of(bus.channel, gateway, event_log, folder)) is not None:
            kept.begin()
            self.loop.add_observer(kept.observe)
        self._service = ServiceReporter(manager, runtime, self.loop)
        self._service.begin()
        self.facts.start = self._service.start
        self.loop.keep(restart_state)
        self.loop.add_observer(self._service.observe)

    def run(self, duration_s: float | None = None) -> None:
        """Tick until the loop is stopped, or for `duration_s`; then record the orderly end.

        Raises UnavailableError where the bus did not take the last safe frames: they stay in
        their file, and the service manager sends them.
        """
        if self._tap is not None:
            self._tap.begin()
        try:
            self.loop.run(duration_s)
        finally:
            if self._tap is not None:
                self._tap.close()
        if self._service is not None:
            self._service.end()
        if self.loop.gateway.gave_up:
            what = "ended, but its last safe frames did not leave"
            raise UnavailableError(Problem(what, remedy="look at the bus: vcu-gateway doctor"))


def _tick_loop(config: Config, protocol: ProtocolSpec) -> TickLoop:
    codec, now_ns = Codec(protocol), time.monotonic_ns()
    if config.recorder.socket_path is None:
        gateway = Gateway(codec, core_settings(config), now_ns)
    else:
        gateway = TappedGateway(codec, core_settings(config), now_ns, Tap())
    connection = BusConnection(
        bus_settings(config), codec.identifiers(), gateway.receive, gateway.receiver.command_groups
    )
    return TickLoop(gateway, connection, reopen_ms=config.bus.reopen_ms)


def bus_settings(config: Config) -> BusSettings:
    """The bus connection's settings: the configuration's section but for the reconnector's key."""
    return BusSettings(**config.bus.model_dump(exclude={"reopen_ms"}))


class ApiRunner:
    """The API server of one run; a context manager that opens and closes it.

    An API that cannot be opened is an event, and the gateway goes on without: the controllers
    must hear from it in any case.

    Attributes:
        reloader: takes a new configuration, on a request or on SIGHUP.
    """

    def __init__(
        self, config: Config, protocol: ProtocolSpec, loop: TickLoop, facts: queries.RunFacts
    ) -> None:
        self._loop = loop
        self._config = config
        self.reloader = Reloader(config, protocol, loop)
        context = queries.ServerContext(
            loop=loop,
            reloader=self.reloader,
            facts=facts,
            protocol=definition(protocol, facts.protocol_digest),
            api_counts=lambda: self._server.counts(),  # noqa: PLW0108 - it is made below
        )
        self._server = Server(server_settings(config), Dispatcher(context), TickGaps(loop))
        self._failure_reported = False

    def __enter__(self) -> None:
        self.open()

    def __exit__(self, *exc: object) -> None:
        self.close()

    def open(self) -> None:
        """Listen, where the configuration enables the API."""
        if not self._config.api.enabled:
            return
        try:
            self._server.open()
        except UnavailableError as error:
            fields = {"reason": str(error)}
            self._loop.event_log.emit(Event("api_unavailable", Severity.ERROR, fields))
        else:
            self._server.start()
            fields = {"socket": self._config.api.socket_path}
            self._loop.event_log.emit(Event("api_open", Severity.INFO, fields))

    def close(self) -> None:
        """Close every connection and remove the socket."""
        self._server.close()

    def observe(self, result: TickResult) -> None:
        """After each tick: one event where the API has failed."""
        del result
        if self._server.failed is not None and not self._failure_reported:
            self._failure_reported = True
            fields = {"reason": self._server.failed}
            self._loop.event_log.emit(Event("api_failed", Severity.ERROR, fields))


def server_settings(config: Config) -> ServerSettings:
    """The API server's settings; the accounts exist."""
    api = config.api
    users, groups = configuration.user_number, configuration.group_number
    return ServerSettings(
        socket_path=Path(api.socket_path),
        policy=Policy(
            own_uid=os.geteuid(),
            operator_uids=frozenset(map(users, api.operator_users)),
            operator_gids=frozenset(map(groups, api.operator_groups)),
            service_uids=frozenset(map(users, api.service_users)),
            service_gids=frozenset(map(groups, api.service_groups)),
        ),
        owner=None if api.socket_owner is None else users(api.socket_owner),
        group=None if api.socket_group is None else groups(api.socket_group),
        mode=int(api.socket_mode, 8),
    )
