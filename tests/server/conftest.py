"""A server on a real Unix socket, with a small program behind it."""

import contextlib
import json
import os
import select
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from vcu_gateway.api.errors import ErrorCode, Policy, RequestError
from vcu_gateway.server.server import Server
from vcu_gateway.server.service import ServerSettings, SessionLimits
from vcu_gateway.server.tick_gaps import GapShare, TickGaps

PATIENCE_S = 30.0
MS = 1_000_000
NOBODY = 65534
KNOWN = ("BMS_Status", "IMU")
EVERYONE = Policy(own_uid=os.geteuid())
NO_ONE = Policy(own_uid=NOBODY - 1)


def eventually(is_so: Callable[[], object]) -> None:
    """Wait until it is so; that it never becomes so is the failure."""
    end_s = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end_s, "it did not become so"
        time.sleep(0.002)


class FakeService:
    """Answers reading methods at once, and what changes something when `release` is called.

    Attributes:
        begun: (method, params, caller) of every request that came through.
        calls: (method, number of the connection, arguments) of every call, in their order.
        demand_of: numbers of the connections that own a fresh demand.
        filler: text in every state, to make it long.
    """

    def __init__(self) -> None:
        self.begun: list = []
        self.calls: list = []
        self.held: list = []
        self.filler = ""
        self.bug: Exception | None = None
        self.bug_at_end: Exception | None = None
        self.demand_of: set[int] = set()

    def handle(self, method, params, caller, reply):
        if self.bug is not None:
            raise self.bug
        self.begun.append((method, params, caller))
        self.calls.append(("handle", caller.connection, method))
        if method in ("state.get", "why", "health"):
            reply({"answer": method, "filler": self.filler})
        else:
            self.held.append(reply)

    def release(self, answer=None):
        """Reply to everything that waits, on a thread of its own, as the ticking thread does."""
        held, self.held = self.held, []
        answer = answer or {"granted": True, "mode": "standby"}
        thread = threading.Thread(target=lambda: [reply(answer) for reply in held])
        thread.start()
        thread.join()

    def state(self, messages):
        for name in messages or ():
            if name not in KNOWN:
                raise RequestError(ErrorCode.INVALID_PARAMS, f"there is no message {name!r}")
        stamp_ns = time.monotonic_ns()
        return {"monotonic_ns": stamp_ns, "filler": self.filler, "messages": messages}

    def owns_demand(self, caller):
        return caller.connection in self.demand_of

    def log_refused(self, method, caller, sentence):
        self.calls.append(("log_refused", caller.connection, method, sentence))

    def log_closed(self, caller, reason):
        self.calls.append(("log_closed", caller.connection, reason))

    def end_demands(self, caller):
        if self.bug_at_end is not None:
            raise self.bug_at_end
        self.calls.append(("end_demands", caller.connection))

    def calls_of(self, method):
        return [call[2:] for call in self.calls if call[0] == method]


class Client:
    """The other end, blocking, with patience."""

    def __init__(self, sock: socket.socket) -> None:
        sock.settimeout(PATIENCE_S)
        self.sock = sock
        self._buffer = b""

    def send(self, data: bytes) -> None:
        self.sock.sendall(data)

    def request(self, method: str, request_id=1, **params) -> None:
        message = {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}
        self.send(json.dumps(message).encode() + b"\n")

    def notify(self, method: str, **params) -> None:
        message = {"jsonrpc": "2.0", "method": method, "params": params}
        self.send(json.dumps(message).encode() + b"\n")

    def line(self):
        """The next message; None at the end."""
        while b"\n" not in self._buffer:
            try:
                chunk = self.sock.recv(65536)
            except ConnectionResetError:
                return None
            if not chunk:
                return None
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\n")
        return json.loads(line)

    def ask(self, method: str, request_id=1, **params):
        """The result, or the error."""
        self.request(method, request_id, **params)
        answer = self.line()
        assert answer["id"] == request_id
        return answer.get("result", answer.get("error"))

    def rest(self) -> bytes:
        """Everything until the end."""
        data = self._buffer
        with contextlib.suppress(ConnectionResetError):
            while chunk := self.sock.recv(65536):
                data += chunk
        return data

    def has_news(self) -> bool:
        """True where something can be read, be it the end."""
        return bool(select.select([self.sock], [], [], 0)[0])

    def is_ended(self) -> bool:
        """True where nothing can be read any more."""
        try:
            return self.has_news() and not self.sock.recv(65536)
        except OSError:
            return True

    def half_close(self) -> None:
        self.sock.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        self.sock.close()


class NeverTicking:
    """A loop whose next tick is due for ever."""

    schedule = SimpleNamespace(period_ns=50 * MS, next_deadline_ns=0)


class Api:
    """A server with its program, its socket and those who talk to it."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "control.sock"
        self.service = FakeService()
        self.server: Server | None = None
        self._clients: list[Client] = []

    def make(self, limits=SessionLimits(), policy=EVERYONE, gaps=None, **settings) -> Server:  # noqa: B008
        """A server that is not open yet."""
        wanted = ServerSettings(self.path, policy, limits=limits, **{"mode": 0o666, **settings})
        gaps = gaps or TickGaps(NeverTicking(), GapShare(share=1.0))
        self.server = Server(wanted, self.service, gaps)
        return self.server

    def start(self, *args, **kwargs) -> "Api":
        server = self.make(*args, **kwargs)
        server.open()
        server.start()
        return self

    def connect(self) -> Client:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.settimeout(PATIENCE_S)
        sock.connect(os.fspath(self.path))
        return self._keep(sock)

    def _keep(self, sock: socket.socket) -> Client:
        self._clients.append(Client(sock))
        return self._clients[-1]

    def counts(self):
        return self.server.counts()

    def close(self) -> None:
        for client in self._clients:
            client.close()
        if self.server is not None:
            self.server.close()


@pytest.fixture
def folder() -> Iterator[Path]:
    """A short path, which other users may reach."""
    path = Path(tempfile.mkdtemp(prefix="vcu-api-"))
    path.chmod(0o755)
    yield path
    shutil.rmtree(path)


@pytest.fixture
def idle_api(folder) -> Iterator[Api]:
    """Not started yet."""
    api = Api(folder)
    yield api
    api.close()
    assert (
        api.server is None or api.server.failed is None or api.service.bug or api.service.bug_at_end
    )


@pytest.fixture
def api(idle_api) -> Api:
    return idle_api.start()


@pytest.fixture
def client(api) -> Client:
    return api.connect()


@contextlib.contextmanager
def a_stranger(uid: int = NOBODY) -> Iterator[None]:
    """What connects in here is not root, whom nothing can be refused."""
    own = os.geteuid()
    if own == 0:
        os.seteuid(uid)
    try:
        yield
    finally:
        os.seteuid(own)
