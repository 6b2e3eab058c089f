"""Flood of the API: lateness of the ticks and latency of requests, two source trees in turns.

    python -m bench.api_loop TREE_A TREE_B --pairs 10 --pin

Each run starts `tests.app.ticking` of its tree on the virtual bus, arms it, and watches a quiet
stretch and one with the hostile clients of `tests.server.flood`. Beside the flood a driver renews
its demand and a reader asks `why`; both are timed. A pair is a run of each tree; every other pair
begins with TREE_B. Prints a line of JSON for each run, then the medians of both trees.
"""

import argparse
import contextlib
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.processors import started_on

from bench.figures import percentile

_HERE = Path(__file__).resolve().parent.parent
_PERIOD_NS = 50_000_000
_DEMAND_EVERY_S = 0.05
_READ_EVERY_S = 0.02
_ARM_WITHIN_S = 60.0
_REPLY_WITHIN_S = 10.0
_END_WITHIN_S = 60.0
_START_FLOOD_S = 0.5
_LOOK_EVERY_S = 0.05
_SHARES = (("p50", 0.5), ("p99", 0.99), ("max", 1.0))


class Connection:
    """Blocking JSON-RPC connection that times its requests.

    Attributes:
        latencies_ns: (when it was sent, how long the answer took) of each request.
    """

    def __init__(self, path: Path) -> None:
        self.latencies_ns: list[tuple[int, int]] = []
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._sock.settimeout(_REPLY_WITHIN_S)
        self._sock.connect(str(path))
        self._file = self._sock.makefile("rb")

    def request(self, method: str, **params: object) -> dict[str, Any]:
        """The response; ConnectionError where the gateway has closed the connection."""
        message = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        sent_ns = time.monotonic_ns()
        self._sock.sendall(json.dumps(message).encode() + b"\n")
        line = self._file.readline()
        if not line:
            raise ConnectionError("closed by the gateway")
        self.latencies_ns.append((sent_ns, time.monotonic_ns() - sent_ns))
        response: dict[str, Any] = json.loads(line)
        return response

    def close(self) -> None:
        self._file.close()
        self._sock.close()


class Driver(threading.Thread):
    """Renews a demand without throttle and arms the vehicle.

    Attributes:
        mode: of the gateway, in the last granted answer; None before the first and after a loss.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(name="driver", daemon=True)
        self.mode: str | None = None
        self.connection = Connection(path)
        self._end = threading.Event()
        self._has_been_active = False

    def run(self) -> None:
        try:
            while not self._end.wait(_DEMAND_EVERY_S):
                self._renew()
        except OSError:
            self.mode = None

    def stop(self) -> None:
        self._end.set()
        self.join()
        self.connection.close()

    def _renew(self) -> None:
        sequence = time.monotonic_ns() // 1000
        demand = {"source": "driver", "sequence": sequence, "values": {}}
        answer = self.connection.request("demand.set", **demand)
        self.mode = answer.get("result", {}).get("mode")
        if self.mode == "active":
            self._has_been_active = True
        elif not self._has_been_active:
            self.connection.request("arm")


class Reader(threading.Thread):
    """Asks `why` now and then, and connects again where its connection gave way.

    Attributes:
        gave_way: connections that the gateway closed.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(name="reader", daemon=True)
        self.gave_way = 0
        self.latencies_ns: list[tuple[int, int]] = []
        self._path = path
        self._end = threading.Event()

    def run(self) -> None:
        while not self._end.is_set():
            try:
                self._read()
            except OSError:
                self.gave_way += 1
                time.sleep(_READ_EVERY_S)

    def stop(self) -> None:
        self._end.set()
        self.join()

    def _read(self) -> None:
        with contextlib.closing(Connection(self._path)) as connection:
            connection.latencies_ns = self.latencies_ns
            while not self._end.wait(_READ_EVERY_S):
                connection.request("why")


def measure(tree: Path, options: argparse.Namespace) -> dict[str, Any]:
    """One run of this tree: figures of the quiet and of the flooded stretch."""
    with (
        tempfile.TemporaryDirectory(prefix="api-loop-") as name,
        _gateway(tree, Path(name), options),
    ):
        path = Path(name) / "control.sock"
        driver, reader = Driver(path), Reader(path)
        driver.start()
        _await_active(driver)
        reader.start()
        quiet = _stretch(options.seconds)
        was_active = driver.mode == "active"
        flood = _flood(path, options)
        try:
            time.sleep(_START_FLOOD_S)
            flooded = _stretch(options.seconds)
            is_active = driver.mode == "active"
        finally:
            flood.kill()
            flood.wait()
        driver.stop()
        reader.stop()
        ticks = _ticks(Path(name) / "lateness")
    found: dict[str, Any] = {"tree": str(tree), "drive kept": [was_active, is_active]}
    for label, (begin_ns, end_ns) in (("quiet", quiet), ("flood", flooded)):
        found |= _tick_figures(label, ticks, begin_ns, end_ns)
        found |= _latency_figures(
            f"{label} demand", driver.connection.latencies_ns, begin_ns, end_ns
        )
        found |= _latency_figures(f"{label} why", reader.latencies_ns, begin_ns, end_ns)
    return {**found, "reader gave way": reader.gave_way}


@contextlib.contextmanager
def _gateway(tree: Path, folder: Path, options: argparse.Namespace) -> Iterator[None]:
    """The gateway of this tree on its processor, ready for requests."""
    environment = {**os.environ, "PYTHONPATH": f"{tree / 'src'}:{tree}"}
    command = [sys.executable, "-m", "tests.app.ticking", str(folder)]
    with started_on(options.gateway_processors):
        process = subprocess.Popen(
            command, cwd=tree, env=environment, stdout=subprocess.PIPE, text=True
        )
    try:
        assert process.stdout is not None
        # A line of its log, written at the same time, may stand before it.
        if not any(line.endswith("ready\n") for line in process.stdout):
            raise RuntimeError(f"the gateway of {tree} did not start")
        threading.Thread(target=process.stdout.read, daemon=True).start()  # its log
        yield
    finally:
        process.terminate()
        process.wait(_END_WITHIN_S)


def _flood(path: Path, options: argparse.Namespace) -> subprocess.Popen[str]:
    seconds = options.seconds + 10 * _START_FLOOD_S
    arguments = ["--clients", str(options.clients), "--seconds", str(seconds)]
    command = [sys.executable, "-m", "tests.server.flood", str(path), *arguments]
    return subprocess.Popen(command, cwd=_HERE, stdout=subprocess.DEVNULL, text=True)


def _await_active(driver: Driver) -> None:
    end_s = time.monotonic() + _ARM_WITHIN_S
    while driver.mode != "active":
        if time.monotonic() > end_s:
            raise TimeoutError(f"the vehicle could not be armed: mode {driver.mode}")
        time.sleep(_LOOK_EVERY_S)


def _stretch(seconds: float) -> tuple[int, int]:
    begin_ns = time.monotonic_ns()
    time.sleep(seconds)
    return begin_ns, time.monotonic_ns()


def _ticks(file: Path) -> list[tuple[int, int]]:
    """(deadline, lateness) of each tick in ns."""
    lines = file.read_text(encoding="utf-8").splitlines()
    return [(int(deadline), int(lateness)) for deadline, lateness in map(str.split, lines)]


def _tick_figures(
    label: str, ticks: list[tuple[int, int]], begin_ns: int, end_ns: int
) -> dict[str, float]:
    inside = [tick for tick in ticks if begin_ns <= tick[0] < end_ns]
    due = round((inside[-1][0] - inside[0][0]) / _PERIOD_NS) + 1
    lateness_us = [lateness / 1e3 for _, lateness in inside]
    return {
        f"{label} skipped ticks": due - len(inside),
        **_percentiles(f"{label} lateness", "us", lateness_us),
    }


def _latency_figures(
    label: str, latencies_ns: list[tuple[int, int]], begin_ns: int, end_ns: int
) -> dict[str, float]:
    inside_ms = [took / 1e6 for sent, took in latencies_ns if begin_ns <= sent < end_ns]
    figures = _percentiles(f"{label} latency", "ms", inside_ms) if inside_ms else {}
    return {f"{label} answers": len(inside_ms), **figures}


def _percentiles(label: str, unit: str, values: list[float]) -> dict[str, float]:
    return {
        f"{label} {name} {unit}": round(percentile(values, share), 3) for name, share in _SHARES
    }


def _report(found: dict[str, list[dict[str, Any]]]) -> str:
    """Table of the medians of both trees, and in how many pairs A was lower."""
    a, b = found["A"], found["B"]
    lines = ["| figure | median A | median B | A lower | B lower |", "|---|---|---|---|---|"]
    for key in [key for key, value in a[0].items() if isinstance(value, int | float)]:
        pairs = [(one.get(key), other.get(key)) for one, other in zip(a, b, strict=True)]
        known = [(x, y) for x, y in pairs if x is not None and y is not None]
        of_a, of_b = (statistics.median(column) for column in zip(*known, strict=True))
        a_lower, b_lower = sum(x < y for x, y in known), sum(y < x for x, y in known)
        lines.append(f"| {key} | {of_a:g} | {of_b:g} | {a_lower} | {b_lower} |")
    lost = {name: sum(not run["drive kept"][1] for run in runs) for name, runs in found.items()}
    return "\n".join([*lines, "", f"drives lost in the flood: A {lost['A']}, B {lost['B']}"])


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.api_loop", description=__doc__)
    parser.add_argument("tree_a", type=Path, metavar="TREE_A")
    parser.add_argument("tree_b", type=Path, metavar="TREE_B")
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each stretch")
    parser.add_argument("--clients", type=int, default=50)
    pin = parser.add_mutually_exclusive_group()
    pin.add_argument("--pin", action="store_true", help="gateway and flood on different processors")
    pin.add_argument("--pin-same", action="store_true", help="both on the same processor")
    options = parser.parse_args()
    processors = sorted(os.sched_getaffinity(0))
    if options.pin and len(processors) < 2:
        parser.error("--pin needs two processors")
    is_pinned = options.pin or options.pin_same
    options.gateway_processors = set(processors[:1] if is_pinned else processors)
    options.flood_processors = set(processors[1:]) if options.pin else options.gateway_processors
    return options


def main() -> None:
    options = _options()
    os.sched_setaffinity(0, options.flood_processors)
    trees = {"A": options.tree_a.resolve(), "B": options.tree_b.resolve()}
    found: dict[str, list[dict[str, Any]]] = {"A": [], "B": []}
    for pair in range(options.pairs):
        for name in "AB" if pair % 2 == 0 else "BA":
            load = round(os.getloadavg()[0], 2)
            run = {
                "run": name,
                "pair": pair,
                "load average": [load],
                **measure(trees[name], options),
            }
            found[name].append(run)
            print(json.dumps(run), flush=True)
    print(_report(found))


if __name__ == "__main__":
    main()
