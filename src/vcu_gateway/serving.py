"""The API and the reload beside a running gateway, put together from the configuration."""

import hashlib
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

from vcu_gateway import __version__, app
from vcu_gateway import config as configuration
from vcu_gateway.api.results import ApiCounts
from vcu_gateway.api.rights import Policy
from vcu_gateway.config import Config
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.schedule import Tick
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.reload import EffectiveConfig, Reloader
from vcu_gateway.daemon.restarts import CountedStart
from vcu_gateway.errors import UnavailableError
from vcu_gateway.server import health
from vcu_gateway.server.context import ServerContext
from vcu_gateway.server.dispatch import Dispatcher
from vcu_gateway.server.server import Server
from vcu_gateway.server.sockets import ServerSettings
from vcu_gateway.server.tick_gaps import TickGaps
from vcu_gateway.server.views import definition

_NS_PER_S = 1_000_000_000
_DIGEST_CHARACTERS = 16


class Serving:
    """The API of one run, open or not; the accounts in its configuration exist.

    An API that cannot be had is told as an event, and the gateway goes on without: the
    controllers must hear from it in any case.
    """

    def __init__(
        self,
        config: Config,
        protocol: ProtocolSpec,
        daemon: TickLoop,
        log_lines_dropped: Callable[[], int],
        start: CountedStart | None = None,
    ) -> None:
        self._daemon = daemon
        self._config = config
        in_effect = EffectiveConfig(config)
        self.reloader = Reloader(in_effect, protocol, daemon, app.settings)
        facts = health.RunFacts(
            protocol_digest=digest_of(config),
            start=start,
            log_lines_dropped=log_lines_dropped,
        )
        self._program = ServerContext(
            daemon=daemon,
            bus=app.bus_settings(config),
            in_effect=in_effect,
            reloader=self.reloader,
            facts=facts,
            protocol=definition(protocol, facts.protocol_digest),
            exporter=self._metrics(in_effect, facts),
            api_counts=self._api_counts,
        )
        gaps = TickGaps(lambda: daemon.schedule.next_deadline_ns, daemon.schedule.period_ns)
        self._server = Server(server_settings(config), Dispatcher(self._program), gaps)
        self._told_failure = False

    def open(self) -> None:
        """Begin to answer, where the configuration wants it."""
        if not self._config.api.enabled:
            return
        try:
            self._server.open()
        except UnavailableError as error:
            self._tell("api_unavailable", str(error))
        else:
            self._server.start()
            fields = {"socket": self._config.api.socket_path}
            self._daemon.journal.tell(Event("api_open", Severity.INFO, fields))
            if self._server.metrics_unavailable is not None:
                self._tell("metrics_unavailable", self._server.metrics_unavailable)

    def close(self) -> None:
        """End every connection and remove the socket."""
        self._server.close()

    def observe(self, tick: Tick, result: TickResult) -> None:
        """After each tick: an API that has failed is told of, once."""
        del tick, result
        if self._server.failed is not None and not self._told_failure:
            self._told_failure = True
            self._tell("api_failed", self._server.failed)

    def _api_counts(self) -> ApiCounts:
        return self._server.counts()

    def _tell(self, name: str, reason: str) -> None:
        self._daemon.journal.tell(Event(name, Severity.ERROR, {"reason": reason}))

    def _metrics(
        self, in_effect: EffectiveConfig, facts: health.RunFacts
    ) -> Callable[[], bytes] | None:
        from vcu_gateway import exporter

        told = exporter.Facts(
            version=__version__,
            python=platform.python_version(),
            protocol_digest=facts.protocol_digest,
            config_digest=lambda: configuration.digest(in_effect.config),
            started_ns=facts.started_ns,
            started_s=time.time() - (time.monotonic_ns() - facts.started_ns) / _NS_PER_S,
            starts=facts.start and facts.start.number,
            log_lines_dropped=facts.log_lines_dropped,
        )
        try:
            return exporter.exposition(self._daemon, self._api_counts, told).text
        except UnavailableError:
            return None


def server_settings(config: Config) -> ServerSettings:
    """What the server is told; the accounts exist."""
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
        metrics_port=api.metrics_port,
    )


def digest_of(config: Config) -> str:
    """The beginning of the SHA-256 of the DBC in use."""
    contents = app.dbc_path(config).read_bytes()
    return hashlib.sha256(contents).hexdigest()[:_DIGEST_CHARACTERS]
