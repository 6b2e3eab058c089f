"""The tap of a running gateway: everything the recorder gets is the same in another core."""

import contextlib
import itertools
import socket
import time

import can
import pytest

from tests.app.conftest import PATIENT
from tests.daemon.tap_listener import TapListener, replayed
from tests.driven import Driven, driven, wait_until
from vcu_gateway import config as configuration
from vcu_gateway.app import Application
from vcu_gateway.client import RefusedError
from vcu_gateway.config.checks import load_protocol
from vcu_gateway.core.calls import RunTick
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.recording import datagram
from vcu_gateway.recording.call_text import settings_of
from vcu_gateway.recording.core_lines import LineParser, Placed
from vcu_gateway.recording.tap import TappedGateway

CHECKPOINT = b'{"checkpoint":'


@pytest.fixture
def path(tmp_path):
    return tmp_path / "tap.sock"


@pytest.fixture
def listener(path):
    one = TapListener(path)
    yield one
    one.close()


def with_tap(path, socket_path="{path}"):
    return PATIENT + f"recorder: {{socket_path: {socket_path.format(path=path)}}}\n"


def recorded(listener: TapListener, driven: Driven) -> list[bytes]:
    """The only connection's datagrams, once the last tick's has come."""
    done = driven.loop.schedule.ticks
    wait_until(lambda: listener.ticks > done, "the last datagrams")
    return listener.connections[0]


def drive(one: Driven) -> None:
    """Arm, drive, disarm, reload, stop, reset: a request of every kind."""
    one.until_ready()
    with one.client() as client, pytest.raises(RefusedError):
        client.reset()
    with one.client() as client, client.demand("driver") as demand:
        demand.set(throttle_pct=0)
        time.sleep(0.5)
        client.arm()
        demand.set(throttle_pct=20)
        one.until(lambda: max(one.throttles(), default=0) > 20, "throttle")
        client.disarm()
        one.until_mode("standby")
    with one.client() as client:
        one.configure("limits: {derated_power_w: 9000}\n")
        client.reload()
        client.estop()
        one.until_mode("fault")


@pytest.mark.clock
def test_every_tick_of_a_running_gateway_is_replayed_to_the_byte(tmp_path, path, listener):
    with driven(tmp_path, always=with_tap(path)) as one:
        drive(one)
    replay = replayed(recorded(listener, one))
    assert len(replay.ticks) == one.loop.schedule.ticks, "from the first to the last"
    modes = {tick.mode for tick in replay.ticks}
    assert modes == set(Mode)
    assert len(replay.sentences) > 5
    assert {"link_open", "config_reloaded", "api_request", "stop_stage"} <= set(replay.events)
    assert "mode_changed" not in replay.events, "it stands with its tick"
    assert replay.frames == one.loop.connection.counters.received
    assert replay.last.header.frames == replay.frames


def test_the_recorders_wait_is_ended_after_what_may_be_urgent_and_only_then(tmp_path, path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(path))
        listening.listen(64)
        listening.settimeout(10)
        with driven(tmp_path, always=with_tap(path)) as one:
            recorded_connection, _ = listening.accept()
            one.until_ready()
            time.sleep(0.5)  # ten ticks in which nothing happens
        others = connections_without_datagrams(listening)
        with recorded_connection:
            received = list(iter(lambda: recorded_connection.recv(1 << 20), b""))
        ticks = [one for one in received if one[0] == datagram.TICK]
    urgent = sum(datagram.may_be_urgent(one) for one in ticks)
    assert others == urgent
    assert 3 <= urgent < len(ticks) - 5


def connections_without_datagrams(listening: socket.socket) -> int:
    """How many wait to be accepted; each is closed and brought nothing."""
    listening.setblocking(False)
    count = 0
    with contextlib.suppress(BlockingIOError):
        while True:
            connection, _ = listening.accept()
            with connection:
                assert connection.recv(1) == b""
            count += 1
    return count


def test_the_hello_holds_what_a_replay_needs(tmp_path, path, listener):
    with driven(tmp_path, always=with_tap(path)) as one:
        one.until(lambda: listener.ticks > 2, "datagrams")
    hello = replayed(listener.connections[0]).hello
    loaded = configuration.load(one.file)
    assert configuration.parse(hello["config"], "hello") == loaded
    assert hello["config_digest"] == configuration.digest(loaded)
    stale = settings_of(hello["settings"]).stale_after_ms
    assert stale == loaded.freshness.stale_after_ms != Settings().stale_after_ms
    assert "BO_ " in hello["dbc"]
    assert len(hello["run"]) == 32
    assert hello["clock"]["wall_ns"] == pytest.approx(time.time_ns(), abs=3600e9)
    assert set(hello["versions"]) == {"gateway", "python", "kernel", "machine"}


@pytest.mark.clock
def test_a_recorder_that_comes_later_gets_the_state_of_then(tmp_path, path):
    with driven(tmp_path, always=with_tap(path)) as one:
        one.until_ready()
        listener = TapListener(path)
        one.until(lambda: listener.ticks > 10, "datagrams")
    ticks = replayed(listener.connections[0]).ticks
    listener.close()
    assert ticks[0].mode is Mode.STANDBY
    assert 10 < len(ticks) < one.loop.schedule.ticks


def events(one: Driven, *names: str) -> list[str]:
    logged = [entry.event.name for entry in one.loop.event_log.latest(200)]
    return [name for name in logged if name in names]


def test_where_no_recorder_is_nothing_is_said_of_it(tmp_path, path):
    with driven(tmp_path, always=with_tap(path)) as one:
        one.until_ready()
        with one.client() as client:
            counts = client.health()["recorder"]
    assert events(one, "recorder_connected", "recorder_lost") == []
    assert counts == {"connected": False, "datagrams": 0, "lost_datagrams": 0, "lost_frames": 0}


def test_a_recorder_that_goes_and_comes_is_two_events(tmp_path, path, listener):
    with driven(tmp_path, always=with_tap(path)) as one:
        one.until(lambda: listener.ticks > 10, "datagrams")
        listener.close_connection()
        one.until(lambda: len(listener.connections) == 2, "another connection")
        one.until(lambda: len(listener.connections[1]) > 10, "datagrams")
    first, second = map(replayed, listener.connections)
    assert first.hello["run"] == second.hello["run"]
    assert first.hello["clock"] == second.hello["clock"]
    logged = events(one, "recorder_connected", "recorder_lost")
    assert sorted(logged) == ["recorder_connected", "recorder_lost"]
    missing = second.last.header.frames - first.frames - second.frames
    assert missing >= 0


def flood(one: Driven) -> bool:
    """Many frames of the IMU; True once datagrams were lost."""
    for _ in range(2_000):
        one.other_node.send(can.Message(arbitration_id=0x08F02DE2, data=bytes(8)))
    time.sleep(0.02)
    with one.client() as client:
        return client.health()["recorder"]["lost_datagrams"] > 3


def test_a_full_socket_loses_datagrams_which_are_counted(tmp_path, path, listener):
    with driven(tmp_path, always=with_tap(path)) as one:
        one.until(lambda: listener.ticks > 10, "datagrams")
        listener.reading.clear()
        one.until(lambda: flood(one), "a full socket")
        listener.reading.set()
        received = listener.connections[0]
        one.until(lambda: sum(CHECKPOINT in one for one in received) == 2, "a checkpoint")
    replay = replayed(received)
    header = replay.last.header
    assert replay.checkpoints == 2
    assert header.datagrams_lost > 3
    assert header.frames == replay.frames + header.frames_lost
    assert header.sequence == len(replay.ticks) + header.datagrams_lost + 1, "the end's own"
    assert events(one, "recorder_connected", "recorder_lost") == ["recorder_connected"]


def test_without_a_tap_the_gateway_is_a_plain_one(tmp_path):
    with driven(tmp_path, always=with_tap("", "null")) as one:
        one.until_ready()
        with one.client() as client:
            assert client.health()["recorder"] is None
    assert type(one.loop.gateway).__name__ == "Gateway"


def test_a_bug_of_the_recording_is_an_event_and_the_gateway_goes_on(tmp_path, path):
    with driven(tmp_path, always=with_tap(path)) as one:
        one.until_ready()
        vars(one.loop.gateway.supervisor)["news"] = object()  # nothing that a checkpoint can hold
        listener = TapListener(path)
        one.until(lambda: events(one, "recording_failed") != [], "the event")
        done = one.loop.schedule.ticks
        one.until(lambda: one.loop.schedule.ticks > done + 25, "ticks after it")
    assert events(one, "recording_failed") == ["recording_failed"]
    assert listener.ticks == 0
    gateway = one.loop.gateway
    assert isinstance(gateway, TappedGateway)
    assert gateway.tap.calls == [], "nothing is gathered any more"
    listener.close()


def test_a_tick_that_ends_the_process_by_a_bug_is_recorded_as_the_last(tmp_path, path, listener):
    file = tmp_path / "gateway.yaml"
    file.write_text(
        f"bus: {{interface: virtual, channel: {tmp_path.name}}}\napi: {{enabled: false}}\n"
        f"recorder: {{socket_path: {path}}}\n"
    )
    loaded = configuration.load(file)
    application = Application(loaded, load_protocol(loaded))
    breaks_after(application.loop, ticks=3)
    with pytest.raises(ValueError, match="not in tuple"):
        application.run()
    wait_until(lambda: listener.ticks == 4, "the last datagram")
    last = datagram.unpack(listener.connections[0][-1])
    (record,) = [one.record for line in last.lines.splitlines() for one in parsed(line)]
    assert isinstance(record.input, RunTick)


def breaks_after(loop: TickLoop, ticks: int) -> None:
    """The next tick after so many fails in the core."""

    done = itertools.count(1)

    def observe(result: TickResult) -> None:
        if next(done) == ticks:
            loop.gateway.supervisor.mode = None

    loop.add_observer(observe)


def parsed(line: bytes) -> list[Placed]:
    return LineParser().records(line)
