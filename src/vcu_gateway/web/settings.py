"""Settings of the page, and what it refuses to start with."""

import ipaddress
import stat
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from vcu_gateway.errors import ConfigError, Problem
from vcu_gateway.web.users import UserRole, Users

_LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})
_DOCS = "docs/web.md says how"


class TlsFiles(NamedTuple):
    """Certificate with its chain, and its key, both PEM."""

    certificate: Path
    key: Path


class WebSettings(NamedTuple):
    """Settings of one run.

    Attributes:
        users: by name; empty: whoever reaches 127.0.0.1 has the role `local_role`.
        host_names: further names that browsers may know this machine by.
        recordings: folder of the recorder; None: there are none to see.
        state_file: where sessions are kept over a restart; None: nowhere.
    """

    address: str
    port: int
    socket_path: Path
    users: Users = MappingProxyType({})
    local_role: UserRole = UserRole.VIEWER
    tls: TlsFiles | None = None
    host_names: tuple[str, ...] = ()
    recordings: Path | None = None
    session_lifetime_s: float = 12 * 3600
    state_file: Path | None = None

    @property
    def is_local(self) -> bool:
        """Whether nobody but this machine can reach it."""
        return ipaddress.ip_address(self.address).is_loopback

    @property
    def known_hosts(self) -> frozenset[str]:
        """Names that a request's Host may have, without the port; others are refused."""
        names = {without_port(name.lower()) for name in self.host_names}
        own = f"[{self.address}]" if ":" in self.address else self.address
        return frozenset(names | {own.lower()}) | (_LOCAL_NAMES if self.is_local else frozenset())

    @property
    def url(self) -> str:
        """Where a browser finds it; port 0 is not known yet."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        return f"{'https' if self.tls else 'http'}://{host}:{self.port}/"

    def check(self) -> None:
        """ConfigError with every reason not to start: a network address needs TLS and users."""
        problems = [*self._network_problems(), *self._tls_problems()]
        if problems:
            raise ConfigError(*problems)

    def _network_problems(self) -> list[Problem]:
        try:
            address = ipaddress.ip_address(self.address)
        except ValueError:
            return [Problem(f"{self.address!r} is no IP address", "--listen")]
        problems = []
        if not self.is_local and self.tls is None:
            what = f"{self.address} can be reached from a network, and there is no TLS"
            problems.append(Problem(what, "--listen", f"give --certificate and --key; {_DOCS}"))
        if not self.is_local and not self.users:
            what = f"{self.address} can be reached from a network, and there are no users"
            problems.append(Problem(what, "--listen", f"give --users FILE; {_DOCS}"))
        if address.is_unspecified and not self.host_names:
            what = f"{self.address} is no name that a browser uses"
            problems.append(Problem(what, "--listen", "give each one with --host-name NAME"))
        return problems

    def _tls_problems(self) -> list[Problem]:
        if self.tls is None:
            return []
        problems = [
            Problem("cannot be read", str(path), "look at its path, owner and mode")
            for path in self.tls
            if not _is_readable(path)
        ]
        if not problems and self.tls.key.stat().st_mode & (stat.S_IROTH | stat.S_IWOTH):
            key = str(self.tls.key)
            problems.append(Problem("others may read this key", key, f"chmod o= {key}"))
        return problems


def without_port(host: str) -> str:
    """Name or address of a Host; an IPv6 address with a port stands in brackets."""
    name, colon, port = host.rpartition(":")
    has_port = colon and port.isascii() and port.isdecimal()
    return name if has_port and (":" not in name or name.endswith("]")) else host


def _is_readable(path: Path) -> bool:
    try:
        with path.open("rb"):
            return True
    except OSError:
        return False
