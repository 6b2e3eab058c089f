"""Requests that nobody should send, to every route; an answer of 500 is a bug.

usage: python -m tests.web.fuzz [COUNT [SEED]], beside a gateway of its own.
"""

import collections
import random
import shutil
import socket
import string
import sys
import tempfile
import time
from pathlib import Path

from tests.web.conftest import PASSWORD, users_lines
from tests.web.stand import WebProcess, gateway_running, serving

PATHS = (
    *("/", "/main.js", "/nothing", "//", "/api", "/api/", "/api/session", "/api/clock"),
    *("/api/history", "/api/history?signals=PCU1_Status2.MotorSpeed", "/api/recordings"),
    *("/api/actions/disarm", "/api/actions/arm", "/api/actions/reset-driver", "/api/actions/x"),
    "/api/recordings/drives/20260101T000000Z-abcdef01/download",
    "/api/recordings/incidents/20260101T000000Z-abcdef01/replay",
    "/api/recordings/drives/20260101T000000Z-abcdef01/what-if",
)
METHODS = ("GET", "POST", "DELETE", "HEAD", "PUT", "OPTIONS", "TRACE", "get", "X" * 40)
BODIES = (b"", b"{}", b"[]", b'{"name": "otto"}', b'{"name": 1, "password": []}', b"[" * 3000)
NAMES = ("Cookie", "Origin", "Host", "Content-Length", "Accept-Encoding", "If-None-Match", "Range")
ODD = (
    "",
    "\x00",
    "..",
    "%00",
    "%2e%2e/",
    "é",
    "\U0001f600",
    "a" * 5000,
    "'",
    "%",
    "%zz",
    "\\",
    "%c0",
)


# Below what one session or one address may ask: the limits are not what is tried.
SESSIONS, ADDRESSES = 24, 250


class Fuzz:
    """Requests made from one seed."""

    def __init__(self, web: WebProcess, seed: int) -> None:
        self.chance = random.Random(seed)
        self.web = web
        self.cookies = [""] * SESSIONS
        self.statuses: collections.Counter[str] = collections.Counter()
        self.bad: list[tuple[str, bytes]] = []

    def request(self) -> bytes:
        chance = self.chance
        method = chance.choice(("GET", "POST") if chance.random() < 0.8 else METHODS)
        body = chance.choice(BODIES) if chance.random() < 0.7 else chance.randbytes(300)
        headers = {"Host": f"127.0.0.1:{self.web.port}", "Content-Length": str(len(body))}
        if method not in ("GET", "HEAD"):
            headers["Origin"] = self.web.url.rstrip("/")
        if chance.random() < 0.8:
            headers["Cookie"] = chance.choice(self.cookies)
        if chance.random() < 0.2:
            headers[chance.choice(NAMES)] = self.odd()
        lines = [f"{name}: {value}" for name, value in headers.items()]
        head = f"{method} {self.path()} HTTP/1.1\r\n" + "\r\n".join(lines) + "\r\n\r\n"
        raw = head.encode(errors="surrogateescape") + body
        return self.broken(raw) if chance.random() < 0.1 else raw

    def path(self) -> str:
        path = self.chance.choice(PATHS)
        if self.chance.random() < 0.4:
            at = self.chance.randrange(len(path) + 1)
            path = path[:at] + self.odd().replace(" ", "") + path[at:]
        if self.chance.random() < 0.3:
            path += f"?signals={self.odd()}&points={self.odd()}"
        return path

    def odd(self) -> str:
        if self.chance.random() < 0.5:
            return self.chance.choice(ODD)
        return "".join(self.chance.choices(string.printable.strip(), k=self.chance.randrange(40)))

    def broken(self, raw: bytes) -> bytes:
        flipped = bytearray(raw)
        for _ in range(self.chance.randrange(1, 6)):
            flipped[self.chance.randrange(len(flipped))] = self.chance.randrange(256)
        return bytes(flipped)

    def send(self, raw: bytes) -> str:
        """The status of the answer; "closed" and "late" where there was none."""
        source = (f"127.0.2.{1 + self.statuses.total() % ADDRESSES}", 0)
        to = ("127.0.0.1", self.web.port)
        try:
            with socket.create_connection(to, timeout=30, source_address=source) as connection:
                connection.sendall(raw)
                connection.shutdown(socket.SHUT_WR)
                status = connection.recv(4096)[9:12].decode("latin-1") or "closed"
        except TimeoutError:
            status = "late"
        except OSError:  # closed before it had read all, such as ENOTCONN
            status = "closed"
        self.statuses[status] += 1
        return status

    def judge(self, raw: bytes) -> None:
        """Send it, once more where the machine may have stood still; what is a bug is kept."""
        if (status := self.send(raw)) == "late":
            status = self.send(raw)
        if status == "late" or (status.startswith("5") and status not in ("503", "504")):
            self.bad.append((status, raw))

    def sign_in(self, place: int) -> None:
        """Sign in anew where a request has signed this session out."""
        if self.web.request("GET", "/api/clock", cookie=self.cookies[place]).status != 200:
            self.web.sign_in(("otto", "anna")[place % 2], PASSWORD)
            self.cookies[place] = self.web.cookie


def fuzzed(web: WebProcess, count: int, seed: int) -> Fuzz:
    """So many requests."""
    fuzz = Fuzz(web, seed)
    for place in range(SESSIONS):
        fuzz.sign_in(place)
    for number in range(count):
        if number % 100 == 0:
            fuzz.sign_in(number // 100 % SESSIONS)
        fuzz.judge(fuzz.request())
    return fuzz


def main(count: int, seed: int) -> int:
    folder = Path(tempfile.mkdtemp(prefix="vcu-web."))
    users = folder / "users"
    users.write_text(users_lines())
    users.chmod(0o600)
    recordings = folder / "recordings"
    (recordings / "drives").mkdir(parents=True)
    options = ("--users", str(users), "--recordings", str(recordings))
    with gateway_running(folder) as gateway, serving(folder, gateway.socket_path, *options) as web:
        begin_s = time.monotonic()
        fuzz = fuzzed(web, count, seed)
        alive = web.process.poll() is None and web.request("GET", "/").status == 200
        taken_s = time.monotonic() - begin_s
        print(f"{count} requests in {taken_s:.0f} s: {dict(fuzz.statuses.most_common())}")
        for status, raw in fuzz.bad[:5]:
            print(f"{status}: {raw[:300]!r}")
        if not alive:
            print("the page is not served any more:", *web.said[-20:], sep="\n")
    shutil.rmtree(folder, ignore_errors=True)
    return 0 if alive and not fuzz.bad else 1


if __name__ == "__main__":
    numbers = [int(text) for text in sys.argv[1:]]
    sys.exit(main(*(numbers + [100_000, 1][len(numbers) :])))
