"""The metrics over HTTP: on the API's socket, and on a port of this machine alone."""

import shutil
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest

from tests.server.conftest import MS, PATIENCE_S, eventually
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.server.http import is_http, judge
from vcu_gateway.server.session import Limits
from vcu_gateway.server.tick_gaps import GapShare, TickGaps

GET = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.fixture
def port_api(idle_api):
    return idle_api.start(metrics_port=0)


@pytest.fixture
def hasty_api(idle_api):
    """Waits for a head only as long as a busy machine may take to write one, and connect more."""
    return idle_api.start(Limits(patience_ns=1500 * MS), metrics_port=0)


def answer_to(client, request: bytes):
    """Status, header fields and body."""
    client.send(request)
    head, _, body = client.rest().partition(b"\r\n\r\n")
    status, *fields = head.decode().split("\r\n")
    assert status.startswith("HTTP/1.1 ")
    return int(status.split()[1]), dict(field.split(": ") for field in fields), body


def test_get_metrics_is_answered_and_the_connection_ends(api, client):
    status, fields, body = answer_to(client, GET)
    assert (status, body) == (200, b"vcu_gateway_up 1\n")
    assert fields == {
        "Content-Type": "text/plain; version=0.0.4; charset=utf-8",
        "Content-Length": "17",
        "Connection": "close",
    }
    eventually(lambda: len(api.service.told("gone")) == 1)
    assert api.service.told("closed") == []
    assert api.counts()["closed"] == {}
    assert api.counts()["requests"] == 0


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl here")
def test_curl_reads_the_metrics_over_the_socket(api):
    run = ["curl", "-sS", "--fail", "-m", "60", "--unix-socket", api.path]
    done = subprocess.run([*run, "http://localhost/metrics"], capture_output=True)
    assert (done.stdout, done.stderr) == (b"vcu_gateway_up 1\n", b"")


def test_an_ordinary_http_client_reads_the_metrics_over_the_port(port_api):
    url = f"http://127.0.0.1:{port_api.server.metrics_port}/metrics"
    with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
        assert answer.read() == b"vcu_gateway_up 1\n"
    assert port_api.counts()["clients"] == 0


def test_head_is_answered_without_a_body(client):
    status, fields, body = answer_to(client, GET.replace(b"GET", b"HEAD"))
    assert (status, fields["Content-Length"], body) == (200, "17", b"")


def test_a_head_may_arrive_byte_by_byte(client):
    for byte in GET[:-1]:
        client.send(bytes([byte]))
    assert answer_to(client, GET[-1:])[0] == 200


ANSWERS = [
    (b"GET /metrics?name=up HTTP/1.0", 200),
    (b"GET http://localhost:9/metrics HTTP/1.1", 200),
    (b"GET / HTTP/1.1", 404),
    (b"GET /metrics/ HTTP/1.1", 404),
    (b"GET //metrics HTTP/1.1", 404),
    (b"GET /metrics", 400),
    (b"GET /metrics HTTP/2", 400),
    (b"GET  /metrics HTTP/1.1", 400),
    (b"POST /metrics HTTP/1.1", 405),
    (b"DELETE / HTTP/1.1", 405),
    (b"GET /\xff\x00 HTTP/1.1", 404),
]


@pytest.mark.parametrize(("line", "status"), ANSWERS)
def test_only_get_and_head_of_metrics_are_there(client, line, status):
    answer = answer_to(client, line + b"\r\nHost: x\r\n\r\n")
    assert answer[0] == status
    assert answer[1]["Connection"] == "close"
    assert (answer[1].get("Allow") == "GET, HEAD") is (status == 405)


def test_json_rpc_is_no_http():
    assert not is_http(b'{"jsonrpc":"2.0"}')
    assert not is_http(b"")
    assert not is_http(b"get / HTTP/1.1")
    assert is_http(b"GET / HTTP/1.1")


def test_http_is_only_understood_at_the_beginning_of_a_connection(client):
    assert client.ask("why")
    client.send(b"GET /metrics HTTP/1.1\n")
    assert client.line()["error"]["code"] == ErrorCode.PARSE_ERROR.value


def test_without_metrics_the_answer_says_what_is_missing(api, client):
    api.service.metrics_failure = RequestError(ErrorCode.NOT_READY, "install the extra")
    status, _, body = answer_to(client, GET)
    assert (status, body) == (503, b"install the extra\n")


def test_scrapes_in_a_row_are_answered_from_one_making(api):
    begin_ns = time.monotonic_ns()
    for _ in range(20):
        assert answer_to(api.connect(), GET)[0] == 200
    most = 1 + (time.monotonic_ns() - begin_ns) // (100 * MS)
    assert api.service.metrics_made <= most, "anew only where they are older than 100 ms"
    time.sleep(0.12)
    made = api.service.metrics_made
    assert answer_to(api.connect(), GET)[0] == 200
    assert api.service.metrics_made == made + 1


def test_the_metrics_are_made_where_10_ms_are_left(idle_api):
    """At 5 ms before a tick there is room for a request, and none for the metrics."""
    now_ns, slept = [45 * MS], []

    def sleep(duration_s: float) -> None:
        slept.append(duration_s)
        now_ns[0] += round(duration_s * 1e9)

    def next_deadline_ns() -> int:
        return (now_ns[0] // (50 * MS) + 1) * 50 * MS

    idle_api.start(
        gaps=TickGaps(next_deadline_ns, 50 * MS, GapShare(), lambda: now_ns[0], lambda: 0, sleep)
    )
    assert idle_api.connect().ask("why")
    assert slept == []
    assert answer_to(idle_api.connect(), GET)[0] == 200
    assert slept == [0.006]


def test_a_head_of_more_than_8_kib_is_refused(port_api):
    for client in (port_api.connect(), port_api.connect_to_port()):
        field = b"X: " + b"x" * 1000 + b"\r\n"
        status, _, _ = answer_to(client, GET[:-2] + field * 9)
        assert status == 431
    for client in (port_api.connect(), port_api.connect_to_port()):
        assert answer_to(client, GET[:-2] + b"X: " + b"x" * 9000)[0] == 431


def test_a_large_head_below_that_is_answered(client):
    field = b"X: " + b"x" * 1000 + b"\r\n"
    assert answer_to(client, GET[:-2] + field * 7 + b"\r\n")[0] == 200


def test_what_follows_a_head_does_not_count_as_head(client):
    body = b"x" * 89 + b"\n"
    assert answer_to(client, b"POST /metrics HTTP/1.1\r\nHost: x\r\n\r\n" + body * 100)[0] == 405


def test_a_head_that_comes_too_slowly_costs_the_connection(hasty_api):
    for client in (hasty_api.connect(), hasty_api.connect_to_port()):
        client.send(GET[:-2])
        end_s = time.monotonic() + PATIENCE_S
        while not client.is_ended():
            assert time.monotonic() < end_s
            try:
                client.send(b"X: y\r\n")
            except OSError:
                break
            time.sleep(0.02)
    assert hasty_api.counts()["closed"] == {"line not finished in time": 2}


def test_the_port_can_be_had_again_at_once(port_api):
    """The side that ends a connection keeps its port occupied for a minute, but for an option."""
    assert answer_to(port_api.connect_to_port(), GET)[0] == 200
    port = port_api.server.metrics_port
    port_api.server.close()
    port_api.start(metrics_port=port)
    assert answer_to(port_api.connect_to_port(), GET)[0] == 200


def test_a_silent_connection_to_the_port_is_ended(hasty_api):
    assert hasty_api.connect_to_port().rest() == b""


def test_the_port_speaks_no_json(port_api):
    client = port_api.connect_to_port()
    status, _, _ = answer_to(client, b'{"jsonrpc":"2.0","id":1,"method":"estop"}\n\n')
    assert status == 400
    assert port_api.service.begun == []


HOSTS = [
    (b"Host: localhost", 200),
    (b"host:LOCALHOST:9100", 200),
    (b"Host: 127.0.0.1", 200),
    (b"Host: 127.0.0.1:80", 200),
    (b"Host: [::1]:9100", 200),
    (b"Host: example.com", 403),
    (b"Host: localhost.example.com", 403),
    (b"Host: 127.0.0.1.example.com", 403),
    (b"Host: example.com:127", 403),
    (b"Host: localhost\r\nHost: example.com", 403),
    (b"Host: localhost@example.com", 403),
    (b"Host:", 403),
    (b"X: localhost", 403),
]


@pytest.mark.parametrize(("field", "status"), HOSTS)
def test_a_web_page_cannot_read_the_metrics_through_a_name_of_its_own(port_api, field, status):
    request = b"GET /metrics HTTP/1.1\r\n" + field + b"\r\n\r\n"
    assert answer_to(port_api.connect_to_port(), request)[0] == status
    assert judge([b"GET /metrics HTTP/1.1", field], must_be_local=False).status == 200


def test_the_port_is_of_this_machine_alone_and_takes_no_place(hasty_api):
    clients = [hasty_api.connect() for _ in range(16)]
    assert all(client.ask("why") for client in clients)
    assert answer_to(hasty_api.connect_to_port(), GET)[0] == 200
    waiting = [hasty_api.connect_to_port() for _ in range(5)]
    eventually(lambda: hasty_api.counts()["turned_away"] == 1)
    assert [client.rest() for client in waiting] == [b""] * 5
    table = Path("/proc/net/tcp").read_text()
    assert f" 0100007F:{hasty_api.server.metrics_port:04X} 00000000:0000 0A " in table
