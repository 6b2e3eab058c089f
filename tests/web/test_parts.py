"""The parts of the page that need no server: sessions, limits, settings, history."""

import asyncio
import json
import math
import socket
from pathlib import Path
from typing import Any

import pytest

from tests.docs.pages import ROOT, directives
from vcu_gateway.api.methods import LEVEL_RIGHTS, METHODS
from vcu_gateway.errors import ConfigError, UnavailableError
from vcu_gateway.units import NS_PER_S
from vcu_gateway.web.access import Sessions
from vcu_gateway.web.application import listening_socket
from vcu_gateway.web.connections import LoginLimit
from vcu_gateway.web.history import CAPACITY, History
from vcu_gateway.web.settings import TlsFiles, WebSettings
from vcu_gateway.web.stream import Broadcast
from vcu_gateway.web.users import ACTION_RIGHTS, PasswordHash, User, UserRole

HOUR_S = 3600.0


# Roles.


def test_actions_need_the_rights_that_the_gateway_wants():
    for name, right in ACTION_RIGHTS.items():
        method, _, level = name.partition(" ")
        assert (LEVEL_RIGHTS[level] if level else METHODS[method].right) is right


def test_each_role_has_what_the_one_before_has_and_more():
    viewer, operator, service = (role.rights for role in UserRole)
    assert viewer < operator < service


# Sessions.


def test_a_session_looks_until_it_ends_and_stops_for_a_day_longer():
    sessions = Sessions(HOUR_S)
    session = sessions.find(sessions.open("anna", 1000.0))
    assert session.is_open(1000.0 + HOUR_S - 1)
    assert not session.is_open(1000.0 + HOUR_S)
    assert session.may_stop(1000.0 + HOUR_S + 23 * HOUR_S)
    assert not session.may_stop(1000.0 + HOUR_S + 24 * HOUR_S)


def test_a_clock_that_was_set_back_opens_no_session():
    sessions = Sessions(HOUR_S)
    session = sessions.find(sessions.open("anna", 1000.0))
    assert not session.is_open(500.0)


def test_a_clock_that_is_set_ends_no_session_also_after_a_restart(tmp_path):
    file = tmp_path / "sessions.json"
    ahead_s = 100.0
    sessions = Sessions(HOUR_S, file, lambda: ahead_s)
    token = sessions.open("anna", 1000.0)
    ahead_s += 10 * 365 * 24 * HOUR_S
    assert sessions.find(token).is_open(1010.0)
    again = Sessions(HOUR_S, file, lambda: ahead_s)
    assert again.find(token).is_open(1020.0)
    assert not again.find(token).is_open(1000.0 + HOUR_S + 1)


def test_a_full_disk_keeps_nobody_from_signing_in_and_leaves_nothing_behind(tmp_path):
    file = tmp_path / "folder" / "sessions.json"
    file.mkdir(parents=True)  # cannot be replaced by a file
    sessions = Sessions(HOUR_S, file)
    assert sessions.find(sessions.open("anna", 0.0)) is not None
    assert list(file.parent.iterdir()) == [file]


def test_tokens_are_random_and_kept_nowhere(tmp_path):
    file = tmp_path / "sessions.json"
    sessions = Sessions(HOUR_S, file)
    tokens = [sessions.open("anna", 0.0) for _ in range(3)]
    assert len(set(tokens)) == 3
    assert all(len(token) >= 43 for token in tokens)
    assert not any(token in file.read_text() for token in tokens)


def test_a_damaged_file_of_sessions_is_none(tmp_path):
    file = tmp_path / "sessions.json"
    for text in ("", "[]", "{}", '{"a": 1}', '{"a": [1, 2]}', "\x00", '{"a": ["x", "y", "z"]}'):
        file.write_text(text)
        assert Sessions(HOUR_S, file).find("x") is None


def test_more_sessions_of_a_user_than_16_end_the_oldest_of_that_user_and_nobody_elses():
    sessions = Sessions(HOUR_S)
    other = sessions.open("otto", 0.0)
    tokens = [sessions.open("anna", 0.0) for _ in range(17)]
    assert sessions.find(tokens[0]) is None
    assert sessions.find(tokens[1]) is not None
    assert sessions.find(other) is not None


def test_the_end_of_one_is_the_end_of_no_other():
    sessions = Sessions(HOUR_S)
    first, second = sessions.open("anna", 0.0), sessions.open("anna", 0.0)
    sessions.close(first)
    assert sessions.find(first) is None
    assert sessions.find(second) is not None


# Attempts to sign in.


def test_five_failures_of_an_address_then_one_each_half_minute():
    limit = LoginLimit()
    for _ in range(5):
        assert limit.wait_s("a", "anna", 0) == 0
        limit.failed("a", "anna", 0)
    assert limit.wait_s("a", "otto", 0) == 30
    assert limit.wait_s("b", "anna", 0) == 0, "somebody else is not kept out"
    assert limit.wait_s("a", "anna", 30 * NS_PER_S) == 0


def test_many_addresses_do_not_try_one_name_for_ever():
    limit = LoginLimit()
    for number in range(20):
        limit.failed(f"address {number}", "anna", 0)
    assert limit.wait_s("another", "anna", 0) == 30
    assert limit.wait_s("another", "otto", 0) == 0


def test_whoever_knew_the_password_begins_anew():
    limit = LoginLimit()
    for _ in range(4):
        limit.failed("a", "anna", 0)
    limit.succeeded("a")
    limit.failed("a", "anna", 0)
    assert limit.wait_s("a", "anna", 0) == 0


# Settings.

ANNA = {"anna": User("anna", UserRole.VIEWER, PasswordHash(16384, 8, 5, bytes(16), bytes(32)))}


def settings(**changes) -> WebSettings:
    return WebSettings("127.0.0.1", 9465, Path("/nobody.sock"))._replace(**changes)


@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.0.2", "::1"])
def test_this_machine_alone_needs_neither_tls_nor_users(address):
    settings(address=address).check()


@pytest.mark.parametrize("address", ["192.0.2.1", "0.0.0.0", "::", "fe80::1", "somewhere"])
@pytest.mark.parametrize("users", [{}, ANNA])
def test_anything_else_without_tls_does_not_start(address, users):
    with pytest.raises(ConfigError):
        settings(address=address, users=users, host_names=("vehicle",)).check()


def test_a_network_address_with_tls_and_users_starts(tmp_path):
    for name in ("chain", "key"):
        (tmp_path / name).write_text("")
        (tmp_path / name).chmod(0o640)
    tls = TlsFiles(tmp_path / "chain", tmp_path / "key")
    settings(address="192.0.2.1", users=ANNA, tls=tls).check()
    with pytest.raises(ConfigError, match="there are no users"):
        settings(address="192.0.2.1", tls=tls).check()
    with pytest.raises(ConfigError, match="no name that a browser uses"):
        settings(address="0.0.0.0", users=ANNA, tls=tls).check()
    tls.key.chmod(0o644)
    with pytest.raises(ConfigError, match="others may read this key"):
        settings(address="192.0.2.1", users=ANNA, tls=tls).check()


def test_a_port_that_another_program_has_ends_the_page_for_good_with_its_reason():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(UnavailableError) as ended:
            listening_socket(settings(port=port))
    assert str(ended.value).startswith(f"cannot listen on 127.0.0.1 port {port}: ")
    assert "ss -ltnp" in str(ended.value)
    (kept_down,) = directives(ROOT / "systemd/vcu-gateway-web.service")["RestartPreventExitStatus"]
    assert str(ended.value.exit_code) in kept_down.split()


def test_the_names_of_this_machine_are_known_and_no_others():
    assert settings().known_hosts == {"127.0.0.1", "localhost", "[::1]"}
    named = settings(address="192.0.2.1", host_names=("Vehicle.lan",))
    assert named.known_hosts == {"192.0.2.1", "vehicle.lan"}


def test_a_name_given_with_its_port_is_known_by_the_name():
    names = ("vehicle.lan:9465", "[fe80::1]:9465", "fe80::1")
    named = settings(address="192.0.2.1", host_names=names)
    assert named.known_hosts == {"192.0.2.1", "vehicle.lan", "[fe80::1]", "fe80::1"}


# History.


def state(at_ms: float, value: float | None = 1.0, quality: str = "good") -> Any:
    signal = {"value": value, "raw": 1, "unit": "", "quality": quality}
    command = {"throttle_pct": 3.0, "brake_pct": 0.0, "speed_limit_rpm": 1.0, "power_limit_w": 1.0}
    return {
        "monotonic_ns": int(at_ms * 1e6),
        "mode": "active",
        "messages": {"M": {"signals": {"S": signal}}},
        "commands": {"PCU1": {**command, "frame": None}},
        "demanded": {},
    }


def test_samples_are_taken_ten_times_a_second():
    history = History()
    for at in range(100):
        history.add(state(at * 50))
    assert len(history.read(["M.S"], 4000)["times_ms"]) == 50


def test_what_is_stale_or_was_never_there_is_a_gap():
    history = History()
    for at, quality in enumerate(["good", "stale", "never", "saturated"]):
        history.add(state(at * 100, 5.0, quality))
    assert history.read(["M.S"], 4000)["values"]["M.S"] == [5.0, None, None, 5.0]


def gaps(read: Any) -> list[int]:
    """Where the signal has no value, by the sample's time."""
    return [
        at for at, one in zip(read["times_ms"], read["values"]["M.S"], strict=True) if one is None
    ]


@pytest.mark.parametrize(("apart_ms", "gap"), [(300, []), (301, [200])])
def test_more_than_three_periods_without_a_state_are_a_gap(apart_ms, gap):
    history = History()
    for at in (0, 100, 100 + apart_ms, 200 + apart_ms):
        history.add(state(at))
    assert gaps(history.read(["M.S"], 4000)) == gap


def test_a_short_gap_in_ten_minutes_stays_a_gap_where_they_are_thinned():
    history = History()
    for at in range(CAPACITY - 1):
        history.add(state(at * 100, quality="stale" if at == 4321 else "good"))
    history.add(state(CAPACITY * 100 + 400))
    assert gaps(history.read(["M.S"], 600)) == [432_100, (CAPACITY - 1) * 100]


@pytest.mark.parametrize("part", [None, 3, "x", [], {}, {"M": None}, {"M": {"signals": None}}])
def test_a_state_with_other_parts_is_a_gap_of_what_they_concern(part):
    history = History()
    history.add(state(0))
    history.add({**state(100), "messages": part})
    history.add({**state(200), "commands": part})
    assert gaps(history.read(["M.S"], 4000)) == [100]
    commanded = history.read(["PCU1.commanded.throttle_pct"], 4000)["values"]
    assert [*commanded.values()] == [[3.0, 3.0, None]]


def test_ten_minutes_are_kept_and_the_oldest_gives_way():
    history = History()
    for at in range(CAPACITY + 10):
        history.add(state(at * 100, float(at)))
    read = history.read(["M.S"], 2 * CAPACITY)
    assert len(read["times_ms"]) == CAPACITY
    assert read["values"]["M.S"][0] == 10


def test_thinning_keeps_every_peak():
    history = History()
    for at in range(CAPACITY):
        history.add(state(at * 100, 100.0 if at == 4321 else math.sin(at)))
    read = history.read(["M.S"], 600)
    assert len(read["times_ms"]) == len(read["values"]["M.S"]) <= 602
    assert max(read["values"]["M.S"]) == 100


def test_ten_minutes_of_every_signal_take_less_than_three_megabytes():
    history = History()
    history.add(state(0))
    sizes = [column.itemsize * len(column) for column in history._columns.values()]
    assert sum(sizes) / len(sizes) * 80 + 8 * CAPACITY < 3_000_000


# Sections.


def test_a_slow_reader_gets_the_latest_of_each_section_and_no_more():
    async def read() -> tuple[bytes, bytes]:
        broadcast, seen = Broadcast(), {}
        for number in range(1000):
            broadcast.publish("state", number)
        broadcast.publish("why", "because")
        return broadcast.unseen(seen), broadcast.unseen(seen)

    first, second = asyncio.run(read())
    assert first == b'event: state\ndata: 999\n\nevent: why\ndata: "because"\n\n'
    assert second == b""


def test_no_text_ends_a_section_early():
    async def read() -> bytes:
        broadcast = Broadcast()
        broadcast.publish("why", {"sentence": "a\n\nevent: state\ndata: 1\r\n\u2028"})
        return broadcast.unseen({})

    lines = asyncio.run(read()).decode().split("\n")
    assert lines[2:] == ["", ""]
    assert "event: state" in json.loads(lines[1].removeprefix("data: "))["sentence"]
