"""The page's server and the gateway as processes, and requests to them as a program makes them."""

import contextlib
import http.client
import json
import os
import queue
import re
import select
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from tests.driven import wait_until

PATIENCE_S = 60.0
ROOT = Path(__file__).parents[2]


class GatewayProcess:
    """A gateway with a simulated vehicle, in a process of its own; the same folder each time."""

    def __init__(self, folder: Path, config: str = "") -> None:
        self.socket_path = folder / "control.sock"
        command = [sys.executable, "-m", "tests.web.gateway_program", str(folder), config]
        self._log = (folder / "gateway.err").open("a")
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        assert self._answer() == "ready"

    def ask(self, name: str, *arguments: Any) -> Any:
        self.begin(name, *arguments)
        return self.answer()

    def begin(self, name: str, *arguments: Any) -> None:
        """Ask without waiting; `answer` has to follow."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([name, arguments]) + "\n")
        self.process.stdin.flush()

    def answer(self) -> Any:
        answered = self._answer()
        assert "error" not in answered, answered
        return answered["value"]

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        readable, _, _ = select.select([self.process.stdout], [], [], PATIENCE_S)
        assert readable, "the gateway's program does not answer"
        line = self.process.stdout.readline()
        assert line, Path(self._log.name).read_text()
        return json.loads(line)

    def kill(self) -> None:
        self.process.kill()
        self._close()

    def end(self) -> None:
        if self.process.poll() is None and self.process.stdin is not None:
            self.process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(20)
        self.process.kill()
        self._close()

    def _close(self) -> None:
        self.process.wait(PATIENCE_S)
        for pipe in (self.process.stdin, self.process.stdout, self._log):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()


class Answer(NamedTuple):
    """Status, headers by small letters, and body of an answer."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


class WebProcess:
    """`vcu-gateway web` as a process; `said` are the lines of its stderr."""

    def __init__(self, folder: Path, socket_path: Path, *options: str, port: int = 0) -> None:
        self._err = folder / f"web-{time.monotonic_ns()}.err"
        listen = () if "--listen" in options else ("--listen", f"127.0.0.1:{port}")
        command = [sys.executable, "-m", "vcu_gateway", "web", "--socket", str(socket_path)]
        with self._err.open("wb") as err:
            self.process = subprocess.Popen([*command, *listen, *options], stderr=err)
        wait_until(lambda: bool(self._url()) or self.process.poll() is not None, "the page's port")
        self.url = self._url()
        self.port = int(self.url.rstrip("/").rpartition(":")[2]) if self.url else 0
        self.cookie = ""

    def _url(self) -> str:
        found = re.search(r" at (https?://\S+)\n", self._err.read_text())
        return found[1] if found else ""

    @property
    def said(self) -> list[str]:
        return self._err.read_text().splitlines()

    def events(self, name: str) -> list[dict[str, Any]]:
        """What it told under this name."""
        told = [json.loads(line) for line in self.said if line.startswith("{")]
        return [event for event in told if event["event"] == name]

    def request(
        self,
        method: str,
        path: str,
        body: bytes | None = None,
        headers: dict[str, str] | None = None,
        cookie: str | None = None,
    ) -> Answer:
        """As the page asks: with its origin and its cookie, unless these are given."""
        sent = {"Host": f"127.0.0.1:{self.port}"}
        if method not in ("GET", "HEAD"):
            sent["Origin"] = self.url.rstrip("/")
        if cookie := self.cookie if cookie is None else cookie:
            sent["Cookie"] = cookie
        sent |= headers or {}
        with contextlib.closing(self._connection()) as connection:
            connection.request(method, path, body, {k: v for k, v in sent.items() if v})
            answer = connection.getresponse()
            fields = {name.lower(): value for name, value in answer.getheaders()}
            return Answer(answer.status, fields, answer.read())

    def _connection(self) -> http.client.HTTPConnection:
        if self.url.startswith("https"):
            context = ssl._create_unverified_context()
            return http.client.HTTPSConnection("127.0.0.1", self.port, timeout=30, context=context)
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)

    def sign_in(self, name: str, password: str) -> Answer:
        """Sign in, and keep the cookie where that is granted."""
        given = json.dumps({"name": name, "password": password}).encode()
        answer = self.request("POST", "/api/session", given, cookie="")
        if answer.status == 200:
            self.cookie = answer.headers["set-cookie"].partition(";")[0]
        return answer

    def act(self, name: str) -> Answer:
        return self.request("POST", f"/api/actions/{name}")

    @contextlib.contextmanager
    def stream(self, headers: Mapping[str, str] = MappingProxyType({})) -> Iterator["Stream"]:
        """The server-sent events."""
        with contextlib.closing(self._connection()) as connection:
            sent = {"Host": f"127.0.0.1:{self.port}", "Cookie": self.cookie, **headers}
            connection.request("GET", "/api/stream", headers=sent)
            answer = connection.getresponse()
            assert answer.status == 200, answer.read()
            yield Stream(answer)

    def end(self, number: int = signal.SIGTERM) -> int:
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


class Stream:
    """Sections of a stream, as they come; `wire_bytes` came, and were `bytes` of text."""

    def __init__(self, answer: http.client.HTTPResponse) -> None:
        self._answer = answer
        self.wire_bytes = self.bytes = 0
        self._received = self._lines()

    def _lines(self) -> Iterator[bytes]:
        is_packed = self._answer.headers.get("content-encoding") == "gzip"
        inflate = zlib.decompressobj(zlib.MAX_WBITS | 16)
        rest = b""
        while data := self._answer.read1(65536):
            plain = inflate.decompress(data) if is_packed else data
            self.wire_bytes, self.bytes = self.wire_bytes + len(data), self.bytes + len(plain)
            *lines, rest = (rest + plain).split(b"\n")
            yield from lines

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        name = ""
        for line in self._received:
            word, _, rest = line.decode().partition(": ")
            if word == "event":
                name = rest
            elif word == "data":
                yield name, json.loads(rest)

    def until(self, name: str, condition: Any = lambda _: True) -> Any:
        """The first section of this name for which the condition holds."""
        end_s = time.monotonic() + PATIENCE_S
        for section, value in self:
            if section == name and condition(value):
                return value
            assert time.monotonic() < end_s, f"no {name} of that kind came"
        raise AssertionError("the stream ended")


@contextlib.contextmanager
def serving(folder: Path, socket_path: Path, *options: str, port: int = 0) -> Iterator[WebProcess]:
    """The page's server, killed with the block; where its coverage is measured, asked to end."""
    measured = "COVERAGE_PROCESS_CONFIG" in os.environ
    one = WebProcess(folder, socket_path, *options, port=port)
    try:
        assert one.url, one.said
        yield one
    finally:
        one.end(signal.SIGTERM if measured else signal.SIGKILL)


@contextlib.contextmanager
def gateway_running(folder: Path, config: str = "") -> Iterator[GatewayProcess]:
    """The gateway, ended with the block."""
    one = GatewayProcess(folder, config)
    try:
        yield one
    finally:
        one.end()


class AlteringRelay:
    """The gateway's socket under another path, each result changed by `alter(method, result)`."""

    def __init__(self, path: Path, to: Path, alter: Callable[[str, Any], Any]) -> None:
        self._to = to
        self._alter = alter
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.socket(socket.AF_UNIX)
                far.connect(str(self._to))
                methods: dict[int, str] = {}
                for ways in ((near, far, methods, False), (far, near, methods, True)):
                    threading.Thread(target=self._pump, args=ways, daemon=True).start()

    def _pump(
        self, source: socket.socket, to: socket.socket, methods: dict[int, str], is_back: bool
    ) -> None:
        with contextlib.suppress(OSError), source.makefile("rb") as lines:
            for line in lines:
                message = json.loads(line)
                if not is_back:
                    methods[message["id"]] = message["method"]
                elif "result" in message:
                    message["result"] = self._alter(methods[message["id"]], message["result"])
                elif "params" in message:
                    message["params"] = self._alter(message["method"], message["params"])
                to.sendall(json.dumps(message).encode() + b"\n")
        for one in (source, to):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.close()


class Proxy:
    """A TCP connection in between that can stall, delay or be cut, as a network does.

    Attributes:
        delay_s: everything that comes from now on arrives later by this.
    """

    def __init__(self, port: int) -> None:
        self._to = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._flows = threading.Event()
        self._flows.set()
        self._sockets: list[socket.socket] = []
        self.delay_s = 0.0
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._to))
                self._sockets += [near, far]
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._pump, args=pair, daemon=True).start()

    def _pump(self, source: socket.socket, to: socket.socket) -> None:
        waiting: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
        threading.Thread(target=self._send, args=(waiting, source, to), daemon=True).start()
        with contextlib.suppress(OSError):
            while data := source.recv(4096):
                waiting.put((time.monotonic() + self.delay_s, data))
        waiting.put((0.0, b""))

    def _send(
        self,
        waiting: "queue.SimpleQueue[tuple[float, bytes]]",
        source: socket.socket,
        to: socket.socket,
    ) -> None:
        with contextlib.suppress(OSError):
            while (item := waiting.get())[1]:
                time.sleep(max(0.0, item[0] - time.monotonic()))
                self._flows.wait()
                to.sendall(item[1])
        for one in (source, to):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def stall(self) -> float:
        """Nothing passes any more; when that began."""
        self._flows.clear()
        return time.time()

    def flow(self) -> None:
        self._flows.set()

    def cut(self) -> None:
        """Every connection ends."""
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        self._sockets.clear()

    def close(self) -> None:
        self._flows.set()
        self._listener.close()
        self.cut()


@contextlib.contextmanager
def proxied(port: int) -> Iterator[Proxy]:
    one = Proxy(port)
    try:
        yield one
    finally:
        one.close()
