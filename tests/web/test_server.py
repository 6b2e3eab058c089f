"""`vcu-gateway web` over HTTP, beside a real gateway: what it serves, and what it refuses."""

import contextlib
import gzip
import http.client
import json
import os
import re
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.driven import wait_until
from tests.faults.pure.bystander import bystander
from tests.processors import held_on, started_on
from tests.web.conftest import PASSWORD
from tests.web.stand import ROOT, WebProcess, gateway_running, serving
from vcu_gateway.client import Client
from vcu_gateway.web.gateway_link import now_ms

SLOW_BYTES_PER_S = 16_000


@pytest.fixture
def web(tmp_path, gateway):
    with serving(tmp_path, gateway.socket_path, "--local-role", "service") as one:
        yield one


@pytest.fixture
def guarded(tmp_path, gateway, users_file):
    with serving(tmp_path, gateway.socket_path, "--users", str(users_file)) as one:
        yield one


def refused_start(tmp_path: Path, *options: str) -> tuple[int, str]:
    one = WebProcess(tmp_path, tmp_path / "nobody.sock", *options)
    try:
        return one.process.wait(20), "\n".join(one.said)
    finally:
        one.end(signal.SIGKILL)


# What is served.


def test_the_page_and_all_that_it_loads_come_from_here_and_forbid_the_rest(web):
    page = web.request("GET", "/")
    assert page.status == 200
    assert page.headers["content-security-policy"].startswith("default-src 'self';")
    assert page.headers["x-frame-options"] == "DENY"
    text = page.body.decode()
    for path in ("/uplot/uPlot.iife.min.js", "/plots.js", "/page.css", "/main.js"):
        assert path in text
        assert web.request("GET", path).status == 200
    assert "http://" not in text
    assert "https://" not in text


def test_a_file_that_the_browser_has_is_not_sent_again(web):
    first = web.request("GET", "/main.js")
    again = web.request("GET", "/main.js", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status, again.body) == (304, b"")


def test_nothing_else_of_the_disk_is_served(web):
    for path in ("/../pyproject.toml", "/..%2f..%2fpyproject.toml", "/page/main.js", "/etc/passwd"):
        assert web.request("GET", path).status == 404


def test_the_page_with_all_its_files_is_150_kb_on_the_wire(web):
    from vcu_gateway.web.page_files import page_files

    packed = {"Accept-Encoding": "gzip"}
    sizes = {path: len(web.request("GET", path, headers=packed).body) for path in page_files()}
    assert sum(sizes.values()) < 150_000, sizes


@pytest.mark.clock
def test_a_stream_begins_with_everything_and_goes_on_with_what_changes(web):
    with web.stream() as stream:
        definition = stream.until("definition")
        assert [one["name"] for one in definition["messages"]][:2] == [
            "ARD2_SteeringWheel",
            "BMS_Status",
        ]
        states = [stream.until("state") for _ in range(20)]
        assert states[-1]["mode"] == "standby"
        assert 800 < states[-1]["t"] - states[0]["t"] < 1500, "twenty a second"
        assert stream.until("why")["sentence"]
        assert stream.until("health")["ticks"]["period_ms"] == 50


def test_the_head_of_the_stream_is_a_whole_answer_and_the_next_one_follows(web):
    connection = http.client.HTTPConnection("127.0.0.1", web.port, timeout=10)
    with contextlib.closing(connection):
        for _ in range(2):
            connection.request("HEAD", "/api/stream")
            answer = connection.getresponse()
            assert (answer.status, answer.read()) == (200, b"")


def test_a_stream_of_http_1_0_has_nothing_but_its_sections(web):
    with socket.create_connection(("127.0.0.1", web.port), 30) as connection:
        connection.sendall(b"GET /api/stream HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n")
        with connection.makefile("rb") as answer:
            assert answer.readline() == b"HTTP/1.1 200 OK\r\n"
            while answer.readline() != b"\r\n":
                pass
            words = {answer.readline().partition(b": ")[0] for _ in range(100)}
    assert words == {b"retry", b"event", b"data", b"\n"}


def test_ten_streams_are_one_subscription(gateway, web):
    with contextlib.ExitStack() as stack:
        streams = [stack.enter_context(web.stream()) for _ in range(10)]
        for stream in streams:
            stream.until("state")
        health = streams[0].until("health")
    assert health["api"]["clients"] <= 4


def test_while_nobody_looks_the_gateway_is_asked_for_nothing_and_then_anew(gateway, web):
    with web.stream() as stream:
        stream.until("why")
    with Client(gateway.socket_path) as client:
        time.sleep(2)
        before = client.health()["api"]["requests"]
        time.sleep(2)
        assert client.health()["api"]["requests"] == before + 1, "our own"
    began_ms = now_ms()
    with web.stream() as stream:
        assert stream.until("why")["t"] > began_ms


def test_the_last_ten_minutes_of_any_signals_are_kept_here(web):
    path = "/api/history?signals=PCU1_Status2.MotorSpeed,PCU1.commanded.throttle_pct"
    wait_until(lambda: len(web.request("GET", path).json.get("times_ms", ())) > 8, "samples")
    history = web.request("GET", path).json
    for values in history["values"].values():
        assert len(values) == len(history["times_ms"])
    assert history["values"]["PCU1.commanded.throttle_pct"][-1] == 0


def test_samples_and_stream_are_packed_for_who_takes_gzip(web):
    wanted = {"Accept-Encoding": "gzip"}
    path = "/api/history?signals=PCU1_Status2.MotorSpeed"
    wait_until(lambda: len(web.request("GET", path).json.get("times_ms", ())) > 50, "samples")
    answer = web.request("GET", path, headers=wanted)
    assert answer.headers["content-encoding"] == "gzip"
    assert len(json.loads(gzip.decompress(answer.body))["times_ms"]) > 50
    with web.stream() as plain, web.stream(wanted) as packed:
        states = [
            {one["t"]: one for one in (stream.until("state") for _ in range(6))}
            for stream in (plain, packed)
        ]
        both = states[0].keys() & states[1].keys()  # a slow reader gets only the latest
        assert both
        assert all(states[0][at_ms] == states[1][at_ms] for at_ms in both)
        assert packed.until("health")["ticks"]["period_ms"] == 50
        assert packed.wire_bytes < 0.6 * packed.bytes


@pytest.mark.parametrize("query", ["", "signals=", "signals=Nothing", "signals=a&points=1"])
def test_a_wrong_question_for_samples_is_a_sentence(web, query):
    answer = web.request("GET", f"/api/history?{query}")
    assert answer.status == 400
    assert answer.json["sentence"]


# Acting.


def test_an_emergency_stop_is_granted_and_every_state_tells_what_became_of_it(gateway, web):
    with web.stream() as stream:
        answer = web.act("estop").json
        assert (answer["answered"], answer["granted"]) == (True, True)
        cut = stream.until("state", lambda one: one["stop"] and one["stop"]["stage"] == "cut")
    assert cut["stop"]["sentence"] == "Power is cut: PCU1 and PCU2 confirm"
    assert set(gateway.ask("cuts")) == {"PCU1", "PCU2"}
    assert web.act("reset-driver").status == 409, (
        "the emergency stop needs a reset at service level"
    )
    wait_until(lambda: web.act("reset-service").json["granted"], "a reset at service level")
    told = [(one["action"], one["granted"]) for one in web.events("action_asked")]
    assert told[:2] == [("estop", True), ("reset driver", False)]
    assert told[-1] == ("reset service", True)
    gateway.ask("reset")


def test_arming_without_a_demand_is_refused_with_the_gateways_sentence(gateway, web):
    gateway.ask("reset")
    answer = web.act("arm")
    assert answer.status == 409
    assert "demand" in answer.json["sentence"]


@pytest.mark.parametrize("name", ["demand", "demand.set", "reload", "", "estop/x"])
def test_there_is_no_other_action_and_no_demand(web, name):
    assert web.act(name).status in (404, 405)


def test_a_stop_without_a_gateway_is_not_answered(tmp_path):
    with serving(tmp_path, tmp_path / "nobody.sock", "--local-role", "service") as web:
        answer = web.act("estop")
    assert answer.status == 503
    assert answer.json["answered"] is False
    assert "systemctl start vcu-gateway" in answer.json["sentence"]


# Who may.


def test_whoever_has_not_signed_in_sees_nothing_and_does_nothing(guarded):
    for path in ("/api/stream", "/api/history?signals=x", "/api/clock", "/api/recordings"):
        assert guarded.request("GET", path).status == 401
    for action in ("estop", "disarm", "arm", "reset-driver"):
        assert guarded.act(action).status == 401
    assert guarded.request("GET", "/api/session").json["signed_in"] is False


def test_a_cookie_is_for_this_site_alone_and_for_no_script(guarded):
    answer = guarded.sign_in("otto", PASSWORD)
    assert answer.json == {"user": "otto", "role": "operator"}
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert "path=/" in cookie
    with guarded.stream() as stream:
        stream.until("state")
    assert guarded.events("signed_in")[0]["user"] == "otto"


def test_a_role_may_what_the_gateways_rights_say(gateway, guarded):
    guarded.sign_in("anna", PASSWORD)
    assert guarded.act("arm").status == 403
    assert guarded.request("GET", "/api/recordings").status == 403
    assert guarded.act("disarm").status in (200, 409)
    guarded.sign_in("otto", PASSWORD)
    assert guarded.act("arm").status == 409, "asked, and refused by the gateway"
    assert guarded.act("reset-service").status == 403
    told = [(one["user"], one["action"]) for one in guarded.events("action_asked")]
    assert ("otto", "arm") in told


def test_a_wrong_password_is_told_and_the_sixth_try_has_to_wait(guarded):
    answers = [guarded.sign_in(name, "wrong") for name in ("otto", "nobody", "otto", "otto", "x")]
    assert {answer.status for answer in answers} == {401}
    assert {answer.json["sentence"] for answer in answers} == {"name or password is wrong"}
    limited = guarded.sign_in("otto", PASSWORD)
    assert limited.status == 429
    assert 0 < int(limited.headers["retry-after"]) <= 30
    assert len(guarded.events("sign_in_failed")) == 5
    assert "wrong" not in "".join(str(event) for event in guarded.events("sign_in_failed"))


def test_signing_out_ends_the_streams_of_that_session_and_no_other(guarded):
    guarded.sign_in("anna", PASSWORD)
    with guarded.stream() as other:
        guarded.sign_in("otto", PASSWORD)
        with guarded.stream() as stream:
            stream.until("state")
            assert guarded.request("DELETE", "/api/session").status == 200
            assert list(stream)
        first = other.until("state")
        other.until("state", lambda state: state["t"] > first["t"] + 2000)


def test_signing_out_ends_the_session_at_once(guarded):
    guarded.sign_in("otto", PASSWORD)
    assert guarded.request("DELETE", "/api/session").status == 200
    assert guarded.request("GET", "/api/clock").status == 401
    assert guarded.act("estop").status == 401


def test_a_session_that_has_ended_looks_no_more_and_still_stops(tmp_path, gateway, users_file):
    options = ("--users", str(users_file), "--session-hours", "0.0005")
    with serving(tmp_path, gateway.socket_path, *options) as web:
        web.sign_in("otto", PASSWORD)
        with web.stream() as stream:
            stream.until("state")
            assert list(stream)[-1], "the stream ends with the session"
        assert web.request("GET", "/api/clock").status == 401
        assert web.act("disarm").status == 401
        assert web.act("estop").json["granted"] is True
        wait_until(lambda: gateway.ask("mode") == "fault", "the tick after the grant")
    gateway.ask("reset")


def test_a_session_outlives_a_kill_of_the_server(tmp_path, gateway, users_file):
    options = ("--users", str(users_file), "--sessions", str(tmp_path / "sessions.json"))
    with serving(tmp_path, gateway.socket_path, *options) as web:
        web.sign_in("otto", PASSWORD)
        cookie = web.cookie
    assert cookie.partition("=")[2] not in (tmp_path / "sessions.json").read_text()
    assert (tmp_path / "sessions.json").stat().st_mode & 0o077 == 0
    with serving(tmp_path, gateway.socket_path, *options) as web:
        assert web.request("GET", "/api/clock", cookie=cookie).status == 200


# Other sites.


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": ""}, 403),
        ({"Origin": "http://127.0.0.1:1"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Host": "evil.example"}, 421),
        ({"Host": "evil.example:80"}, 421),
        ({"Content-Length": "x"}, 400),
    ],
)
def test_what_another_site_makes_a_browser_send_does_nothing(gateway, web, headers, status):
    assert web.request("POST", "/api/actions/estop", headers=headers).status == status
    assert gateway.ask("mode") != "fault"
    assert web.events("action_asked") == []


def test_another_site_reads_nothing_and_no_answer_allows_it_to(web):
    foreign = {"Sec-Fetch-Site": "cross-site", "Origin": "http://evil.example"}
    assert web.request("GET", "/api/clock", headers=foreign).status == 403
    assert web.request("GET", "/api/stream", headers=foreign).status == 403
    assert "access-control-allow-origin" not in web.request("GET", "/").headers


def test_a_name_that_leads_here_by_another_dns_is_refused(web):
    assert web.request("GET", "/api/session", headers={"Host": "rebound.example"}).status == 421


# Starting, ending.


def test_a_network_address_without_tls_and_users_does_not_start(tmp_path, users_file):
    code, said = refused_start(tmp_path, "--listen", "0.0.0.0:0")
    assert code == os.EX_CONFIG
    assert "there is no TLS" in said
    assert "there are no users" in said
    assert "--host-name" in said
    code, said = refused_start(tmp_path, "--listen", "0.0.0.0:0", "--users", str(users_file))
    assert code == os.EX_CONFIG
    assert "there is no TLS" in said


def certificate(folder: Path) -> tuple[Path, Path]:
    chain, key = folder / "chain.pem", folder / "key.pem"
    subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"),
            *("-nodes", "-days", "2", "-subj", "/CN=vcu", "-keyout", key, "-out", chain),
        ],
        check=True,
        capture_output=True,
    )
    return chain, key


def test_with_tls_and_users_it_listens_on_a_network(tmp_path, gateway, users_file):
    chain, key = certificate(tmp_path)
    options = ["--listen", "0.0.0.0:0", "--users", str(users_file), "--host-name", "127.0.0.1"]
    options += ["--certificate", str(chain), "--key", str(key)]
    with serving(tmp_path, gateway.socket_path, *options) as web:
        origin = {"Origin": f"https://127.0.0.1:{web.port}"}
        given = json.dumps({"name": "otto", "password": PASSWORD}).encode()
        answer = web.request("POST", "/api/session", given, origin)
        cookie = answer.headers["set-cookie"]
        assert cookie.startswith("__Host-")
        assert "secure" in cookie.lower()
        assert "max-age=" in answer.headers["strict-transport-security"]
        web.cookie = cookie.partition(";")[0]
        with web.stream() as stream:
            told = stream.until("link", lambda link: link["certificate"])["certificate"]
        assert re.fullmatch(r"The certificate ends on .*: replace it\.", told)
        assert [one["sentence"] for one in web.events("certificate_ends")] == [told]


def test_handshakes_that_never_come_keep_no_other_address_out(tmp_path, gateway, users_file):
    chain, key = certificate(tmp_path)
    options = ["--listen", "0.0.0.0:0", "--users", str(users_file), "--host-name", "127.0.0.1"]
    options += ["--certificate", str(chain), "--key", str(key)]
    with serving(tmp_path, gateway.socket_path, *options) as web, contextlib.ExitStack() as stack:
        to = ("127.0.0.1", web.port)
        begin_s = time.monotonic()
        silent = [socket.create_connection(to, 30, ("127.0.0.2", 0)) for _ in range(300)]
        for one in silent:
            stack.enter_context(one)
        silent[0].send(b"GET / HTTP/1.1\r\n\r\n")
        assert web.request("GET", "/").status == 200
        assert all(is_closed(one) for one in silent)
        assert 8 < time.monotonic() - begin_s < 25
        assert web.request("GET", "/").status == 200
        # Where it is, a certificate of two days, and that the gateway was found.
        assert len(web.said) == 3, web.said


def test_a_certificate_that_is_none_is_named(tmp_path):
    chain, key = tmp_path / "chain.pem", tmp_path / "key.pem"
    for path in (chain, key):
        path.write_text("nothing")
        path.chmod(0o600)
    options = ("--certificate", str(chain), "--key", str(key))
    code, said = refused_start(tmp_path, *options)
    assert code == os.EX_CONFIG
    assert "certificate and key cannot be used" in said


def test_a_port_that_somebody_else_has_is_named_with_a_remedy(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        listen = f"127.0.0.1:{other.getsockname()[1]}"
        code, said = refused_start(tmp_path, "--listen", listen)
    assert code == os.EX_UNAVAILABLE
    assert "ss -ltnp" in said


@pytest.mark.parametrize("mode", [0o644, 0o660])
def test_a_users_file_that_others_read_or_change_is_refused(tmp_path, users_file, mode):
    users_file.chmod(mode)
    code, said = refused_start(tmp_path, "--users", str(users_file))
    assert code == os.EX_CONFIG
    assert f"chmod g-w,o= {users_file}" in said


@pytest.mark.clock
def test_a_signal_ends_it_also_while_browsers_look(web):
    with web.stream() as stream:
        stream.until("state")
        begin_s = time.monotonic()
        assert web.end() == 0
        assert time.monotonic() - begin_s < 4


def test_without_its_libraries_the_error_says_what_to_install():
    lacks = "import sys; sys.modules['starlette'] = None; sys.argv[1:] = ['web'];"
    code = f"{lacks} from vcu_gateway.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == os.EX_UNAVAILABLE
    assert "pip install 'vcu-gateway[web]'" in done.stderr


# Floods and slow ones.


def test_a_gateway_that_ends_and_starts_again_is_found_again(tmp_path, short_folder):
    with serving(tmp_path, short_folder / "control.sock") as web, web.stream() as stream:
        for _ in range(2):
            with gateway_running(short_folder):
                stream.until("link", lambda link: link["problem"] is None)
                stream.until("state")
            stream.until("link", lambda link: link["problem"])


def test_half_a_request_is_not_waited_for_and_too_many_connections_are_closed(web):
    sockets = [socket.create_connection(("127.0.0.1", web.port)) for _ in range(150)]
    for one in sockets:
        one.settimeout(30)
    begin_s = time.monotonic()
    sockets[0].send(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n")
    host = f"127.0.0.1:{web.port}"
    post = f"POST /api/session HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
    sockets[1].send(f"{post}Content-Length: 90\r\n\r\n{{".encode())
    sockets[2].send(f"{post}Transfer-Encoding: chunked\r\n\r\n1\r\n{{\r\n".encode())
    closed = [one for one in sockets if is_closed(one)]
    assert len(closed) == 150
    assert time.monotonic() - begin_s < 25
    assert web.request("GET", "/").status == 200


def is_closed(one: socket.socket) -> bool:
    """Whether it ends, be it after an answer; TimeoutError where it does not."""
    with one, contextlib.suppress(ConnectionError):
        while one.recv(4096):
            pass
    return True


def test_a_browser_that_does_not_read_misses_updates_and_costs_no_memory(web):
    def resident_kb() -> int:
        status = Path(f"/proc/{web.process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0])

    with web.stream() as reading:
        reading.until("state")
        before_kb = resident_kb()
        with socket.create_connection(("127.0.0.1", web.port)) as slow:
            slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            slow.send(f"GET /api/stream HTTP/1.1\r\nHost: 127.0.0.1:{web.port}\r\n\r\n".encode())
            end_s = time.monotonic() + 10
            while time.monotonic() < end_s:
                reading.until("state")
        assert resident_kb() - before_kb < 4000


@pytest.mark.ci
@pytest.mark.clock
def test_a_slow_network_gets_fewer_states_and_none_that_waited_long(web):
    ages_ms = []
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", web.port))
        slow.sendall(f"GET /api/stream HTTP/1.0\r\nHost: 127.0.0.1:{web.port}\r\n\r\n".encode())
        received, end_s = b"", time.monotonic() + 10
        while time.monotonic() < end_s:
            time.sleep(512 / SLOW_BYTES_PER_S)
            received += slow.recv(512)
            while found := re.search(rb'event: state\ndata: {"t":([0-9.]+),', received):
                ages_ms.append(now_ms() - float(found[1]))
                received = received[found.end() :]
    assert 20 < len(ages_ms) < 150, "of 200"
    assert statistics.median(ages_ms[5:]) < 1000


@pytest.mark.ci
@pytest.mark.clock
def test_a_flood_of_requests_keeps_no_stop_out_and_makes_no_tick_late(gateway, web, tmp_path):
    os.setpriority(os.PRIO_PROCESS, web.process.pid, 10)  # as the unit has it
    before = gateway.ask("ticks")
    processor = max(os.sched_getaffinity(0))  # where one cannot run, the other cannot either
    with contextlib.ExitStack() as stack:
        stack.enter_context(held_on(gateway.process.pid, processor))
        with started_on({processor}):
            other = stack.enter_context(bystander(tmp_path))
        other.begin()
        with flooding(web) as answered:
            end_s = time.monotonic() + 4
            while time.monotonic() < end_s:
                answer = web.act("estop")
                assert answer.json["granted"] is True, answer.json
        after, missed = gateway.ask("ticks"), other.missed
    wait_until(lambda: gateway.ask("mode") == "fault", "the tick after the last grant")
    assert answered[0] > 200
    assert after["skipped"] - before["skipped"] <= 2 * missed
    assert gateway.ask("reset") == "standby"


@contextlib.contextmanager
def flooding(web: WebProcess) -> Iterator[list[int]]:
    """As many requests as are answered; their number at the end."""
    command = [sys.executable, "-m", "tests.web.flood", str(web.port)]
    pipe = subprocess.PIPE
    answered: list[int] = []
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "asking\n"
        yield answered
        output, _ = process.communicate()
        answered.append(int(output))


@pytest.mark.ci
def test_the_server_needs_little(web):
    with web.stream() as stream:
        stream.until("state")
    status = Path(f"/proc/{web.process.pid}/status").read_text()
    assert int(status.split("VmRSS:")[1].split()[0]) < 60_000
    for library in ("can", "cantools", "pydantic", "textual"):
        assert f"/{library}/" not in Path(f"/proc/{web.process.pid}/maps").read_text()
