"""`vcu-gateway exporter` as a process, scraped over HTTP."""

import contextlib
import itertools
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.driven import Driven, driven, wait_until
from tests.monitoring.program import Scrape
from vcu_gateway import exporter

PATIENCE_S = 60.0
HEAVY = ("can", "cantools", "pydantic", "yaml", "structlog", "textual", "prometheus_client")


class Exporter:
    """The running process; `said` has the lines of its stderr."""

    def __init__(self, socket_path: Path, listen: str = "127.0.0.1:0") -> None:
        command = [sys.executable, "-m", "vcu_gateway", "exporter", "--listen", listen]
        self.process = subprocess.Popen(
            [*command, "--socket", str(socket_path)], stderr=subprocess.PIPE, text=True
        )
        self.said: list[str] = []
        self.url = ""
        self._reader = threading.Thread(target=lambda: self.said.extend(self.process.stderr))
        self._reader.start()

    def await_first_line(self) -> None:
        """Where it listens, or why it ended."""
        wait_until(
            lambda: bool(self.said) or not self._reader.is_alive(), "a first line or the end"
        )
        found = re.search(r"at (http://\S+)$", self.said[0])
        self.url = found[1] if found else ""

    def scrape(self) -> Scrape:
        with urllib.request.urlopen(self.url, timeout=PATIENCE_S) as answer:
            assert answer.headers["Content-Type"].startswith("text/plain; version=")
            return Scrape(answer.read().decode())

    def end(self, number: int = signal.SIGTERM) -> int:
        """The exit code."""
        self.process.send_signal(number)
        return self.ended()

    def ended(self) -> int:
        """The exit code, once it has ended and all that it said is here."""
        code = self.process.wait(PATIENCE_S)
        self._reader.join()
        return code


@contextlib.contextmanager
def exporting(socket_path: Path, listen: str = "127.0.0.1:0") -> Iterator[Exporter]:
    one = Exporter(socket_path, listen)
    try:
        one.await_first_line()
        yield one
    finally:
        if one.process.poll() is None:
            one.end()


@pytest.fixture(scope="module")
def gateway(tmp_path_factory) -> Iterator[Driven]:
    with driven(tmp_path_factory.mktemp("exported")) as one:
        one.until_ready()
        yield one


def counts(scrape: Scrape) -> dict:
    ends = ("_total", "_bucket", "_count")
    return {key: value for key, value in scrape.samples.items() if key[0].endswith(ends)}


def test_a_running_gateway_is_scraped_and_its_counters_never_go_back(gateway):
    with exporting(gateway.socket_path) as one:
        scrapes = [one.scrape() for _ in range(20)]
        # The vehicle is a thread of this process, and missed while the machine holds it up.
        wait_until(lambda: one.scrape().by("mode", "mode")["standby"] == 1, "the mode")
    for before, after in itertools.pairwise(map(counts, scrapes)):
        assert {key for key, value in before.items() if after[key] < value} == set()
    last = scrapes[-1]
    assert last.value("up") == 1
    assert last.value("ticks_total") <= gateway.loop.schedule.ticks
    assert last.value("frames_received_total") > 0
    assert last.value("starts_total") == 3
    for family in exporter.FAMILIES:
        assert f"# HELP {family.name} {family.help}" in last.text
        assert f"# TYPE {family.name} {family.kind}" in last.text


def test_the_process_is_the_gateways_and_not_the_exporters(gateway):
    with exporting(gateway.socket_path) as one:
        scrape = one.scrape()
    assert scrape.of("process_cpu_seconds_total").popitem()[1] <= time.process_time()
    limit = int(Path("/proc/self/limits").read_text().split("open files")[1].split()[0])
    assert scrape.of("process_max_fds").popitem()[1] == limit
    started_s = scrape.of("process_start_time_seconds").popitem()[1]
    assert started_s == scrape.value("start_time_seconds")


def test_the_limits_are_those_in_effect_also_after_a_reload(tmp_path):
    with driven(tmp_path) as gateway, exporting(gateway.socket_path) as one:
        gateway.until_ready()
        assert one.scrape().value("limit_speed_rpm") == 12_000
        gateway.configure("limits: {speed_limit_max_rpm: 9000, regen_limit_pct: 10.0}\n")
        with gateway.client() as client:
            client.reload()
        scrape = one.scrape()
        assert scrape.value("limit_speed_rpm") == 9000
        assert scrape.value("limit_regen_ratio") == 0.1


def test_a_gateway_that_is_not_there_is_a_metric_and_no_error(tmp_path):
    with exporting(tmp_path / "nobody.sock") as one:
        for _ in range(3):
            assert one.scrape().samples == {("vcu_gateway_up", frozenset()): 0.0}
        assert one.end() == 0
    assert len(one.said) == 2
    assert "systemctl start vcu-gateway" in one.said[1]


def test_a_gateway_that_ends_and_starts_again_is_found_again(tmp_path):
    with exporting(tmp_path / "control.sock") as one:
        for _ in range(2):
            with driven(tmp_path) as gateway:
                gateway.until_ready()
                assert one.scrape().value("up") == 1
            assert one.scrape().value("up") == 0


def test_two_scrapes_at_once_are_both_answered(gateway):
    with exporting(gateway.socket_path) as one, ThreadPoolExecutor(8) as threads:
        scrapes = list(threads.map(lambda _: one.scrape(), range(24)))
        assert {scrape.value("up") for scrape in scrapes} == {1}
        assert {scrape.value("api_clients") for scrape in scrapes} == {1}


def test_a_gateway_that_hangs_is_not_up_and_the_scrape_ends_in_time(tmp_path):
    path = tmp_path / "mute.sock"
    with socket.socket(socket.AF_UNIX) as mute:
        mute.bind(os.fspath(path))
        mute.listen()
        with exporting(path) as one:
            begin_s = time.monotonic()
            assert one.scrape().value("up") == 0
            assert time.monotonic() - begin_s < 10


def test_a_port_that_somebody_else_has_is_named_with_a_remedy(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with exporting(tmp_path / "nobody.sock", f"127.0.0.1:{port}") as one:
            assert one.ended() == os.EX_UNAVAILABLE
    assert one.said[0].startswith(f"error: cannot listen on 127.0.0.1 port {port}: ")
    assert "ss -ltnp" in one.said[0]


@pytest.mark.parametrize("listen", ["9464", ":9464", "127.0.0.1:", "127.0.0.1:65536", "::1:x"])
def test_an_address_that_is_none_is_a_wrong_command_line(tmp_path, listen):
    with exporting(tmp_path / "nobody.sock", listen) as one:
        assert one.ended() == 2
    assert "is not ADDRESS:PORT" in "".join(one.said)


def test_an_interrupt_ends_it_in_order(tmp_path):
    with exporting(tmp_path / "nobody.sock") as one:
        assert one.end(signal.SIGINT) == 0


def run_without(modules: tuple[str, ...], code: str) -> subprocess.CompletedProcess[str]:
    """Python in an environment that lacks these modules."""
    lacks = f"import sys; sys.modules.update(dict.fromkeys({modules!r}));"
    return subprocess.run([sys.executable, "-c", lacks + code], capture_output=True, text=True)


@pytest.mark.parametrize("module", ["vcu_gateway.client", "vcu_gateway.exporter"])
def test_client_and_exporter_need_none_of_the_gateways_libraries(module):
    done = run_without(HEAVY, f"import {module}; print(len({module}.__all__) > 3)")
    assert (done.stdout, done.stderr) == ("True\n", "")


def test_the_http_server_needs_none_of_the_gateways_libraries():
    code = "import vcu_gateway.exporter.prometheus; print('there')"
    done = run_without(HEAVY[:-1], code)
    assert (done.stdout, done.stderr) == ("there\n", "")


def test_without_prometheus_client_the_error_says_what_to_install():
    code = "from vcu_gateway.cli import main; sys.argv[1:] = ['exporter']; main()"
    done = run_without(("prometheus_client",), code)
    assert done.returncode == os.EX_UNAVAILABLE
    assert "pip install 'vcu-gateway[metrics]'" in done.stderr
