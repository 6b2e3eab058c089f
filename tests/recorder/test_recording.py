"""A recorded drive: what a healthy recorder on a healthy disk leaves."""

import ast
import gzip
import signal
import socket
import subprocess
import sys
import time

import pytest

from tests.driven import wait_until
from tests.recorder.gateway import Gateway, account, core_lines, damage, drives, members
from vcu_gateway.recording import datagram, layout


def test_every_frame_is_recorded_in_order(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(2.5)
    vehicle.begin_segment()
    vehicle.drive(1.2)
    vehicle.close()
    assert process.stop() == 0, process.errors
    (drive,) = drives(tmp_path)
    assert account(drive) == (vehicle.frames, 0)
    first, second = layout.segments(drive)
    assert [core_lines(one)[-1]["end"]["why"] for one in (first, second)] == [
        "the next segment begins",
        "the gateway ended the connection",
    ]
    assert not damage(first.frames)
    assert not damage(first.core)
    assert 2 <= len(members(first.frames)) <= 5
    text = gzip.decompress(first.frames.read_bytes()).decode().splitlines()
    assert all(line.endswith(" R") and line.split()[1] == "vcan0" for line in text)


def test_each_gateway_has_a_drive_of_its_own(recorder, gateway, tmp_path):
    process = recorder()
    first, second = gateway(channel="can0"), gateway(channel="can1")
    for _ in range(20):
        first.tick()
        second.tick(frames=5)
    first.drive(0.3)
    status = process.wait_for(lambda status: len(status["connections"]) == 2)
    assert {one["channel"] for one in status["connections"]} == {"can0", "can1"}
    first.close()
    second.close()
    assert process.stop() == 0
    by_run = {layout.read_description(one / "drive.json")["run"]: one for one in drives(tmp_path)}
    assert account(by_run[first.run]) == (first.frames, 0)
    assert account(by_run[second.run]) == (second.frames, 0)


def test_a_gateway_that_connects_again_goes_on_with_its_drive(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(0.5)
    vehicle.close()
    for _ in range(5):
        vehicle.tick()
    vehicle.connect()
    vehicle.drive(0.5)
    vehicle.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    assert account(drive) == (vehicle.frames - 5 * 18, 5 * 18)
    gap = core_lines(layout.segments(drive)[1])[2]["gap"]
    assert gap == {"frames": 90, "ticks": 5, "why": "the recorder did not take them in time"}


def test_what_a_gateway_did_before_the_recorder_was_there_is_a_gap(recorder, gateway, tmp_path):
    vehicle = Gateway(tmp_path / "tap.sock")
    for _ in range(7):
        vehicle.tick()
    process = recorder()
    vehicle.connect()
    vehicle.drive(0.3)
    vehicle.close()
    assert process.stop() == 0
    assert account(drives(tmp_path)[0]) == (vehicle.frames - 7 * 18, 7 * 18)


def test_begin_lines_add_up_what_was_lost(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    for _ in range(3):
        vehicle.drive(0.2)
        vehicle.close()
        vehicle.tick(frames=7)
        vehicle.connect()
    vehicle.drive(0.2)
    vehicle.close()
    assert process.stop() == 0
    begins = [core_lines(one)[1]["begin"] for one in layout.segments(drives(tmp_path)[0])]
    assert [begin["lost"]["frames"] for begin in begins] == [0, 7, 14, 21]
    assert begins[-1]["lost"] == {"frames": 21, "ticks": 3, "gaps": 3}


def test_every_kind_of_frame_stands_as_candump_writes_it(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    kinds = [
        (0x123, b"\x01", False, "123#01 R"),
        (0x8000_0001 | 0x040A_D079, bytes(8), True, "040AD079#0000000000000000 T"),
        (0x4000_0123, b"", False, "123#R R"),
        (0xC40A_D079, b"", False, "040AD079#R R"),
        (0x2000_0040, bytes(8), False, "20000040#0000000000000000 R"),
        (0x8000_0007, bytes(range(12)), False, "00000007##0000102030405060708090A0B R"),
        (0x7FF, b"", False, "7FF# R"),
    ]
    packed = [
        datagram.packed_frame(stamp, can_id, own, data)
        for stamp, (can_id, data, own, _) in enumerate(kinds, vehicle.clock["monotonic_ns"])
    ]
    vehicle.tick(frames=0)
    vehicle.hand_on(packed)
    vehicle.close()
    assert process.stop() == 0
    (segment,) = layout.segments(drives(tmp_path)[0])
    lines = gzip.decompress(segment.frames.read_bytes()).decode().splitlines()
    assert [line.split(" ", 2)[2] for line in lines] == [text for *_, text in kinds]
    stamps = [int(line[1 : line.index(")")].replace(".", "")) for line in lines]
    assert stamps == list(range(vehicle.clock["wall_ns"], vehicle.clock["wall_ns"] + len(kinds)))


@pytest.mark.parametrize(
    "rubbish",
    [
        b"\x00",
        b"\x02\x01\x00",
        b"\x01\x01\x01{}",
        b"\x01\x01\x01[1]",
        b"\x01\x09\x01{}",
        b"\xff" * 100_000,
    ],
)
def test_a_connection_that_hands_on_rubbish_is_closed_and_told(rubbish, recorder, tmp_path):
    process = recorder()
    process.wait_for(lambda status: True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as peer:
        peer.connect(str(process.socket))
        peer.send(rubbish)
        peer.settimeout(5)
        assert peer.recv(1) == b""
    assert process.stop() == 0
    assert "is closed: " in process.errors
    assert drives(tmp_path) == []


def test_frames_that_are_cut_off_cost_the_connection_and_no_more(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(0.3)
    good = vehicle.frames
    header = datagram.TickHeader(vehicle.sequence + 1, vehicle.frames + 3, 0, 0)
    vehicle.sock.send(datagram.packed_tick(header, [b"\x00" * 22] * 3, "")[:-5])
    process.wait_for(lambda status: not status["connections"])
    vehicle.close()
    assert process.stop() == 0
    assert "is closed: the last core line has no end" in process.errors
    assert account(drives(tmp_path)[0]) == (good, 0)


def test_the_socket_of_the_service_manager_is_used(recorder, tmp_path):
    path = tmp_path / "given.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(path))
        listening.listen()
        passed = f'exec 3<&{listening.fileno()}; export LISTEN_PID=$$ LISTEN_FDS=1; exec "$@"'
        process = recorder(before=("bash", "-c", passed, "bash"), pass_fds=(listening.fileno(),))
        vehicle = Gateway(path)
        vehicle.connect()
        vehicle.drive(0.3)
        vehicle.close()
        process.wait_for(lambda status: status["totals"]["frames"] == vehicle.frames)
        assert not process.socket.exists()
        assert process.stop() == 0
    assert path.exists()


def test_the_status_counts_every_frame_and_byte(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(1)
    vehicle.close()
    process.wait_for(lambda status: not status["connections"])
    time.sleep(1.5)
    status = process.status
    assert process.stop() == 0
    written = sum(path.stat().st_size for path in drives(tmp_path)[0].glob("*.gz"))
    assert status["totals"]["frames"] == vehicle.frames
    assert status["totals"]["ticks"] == vehicle.ticks
    assert status["drives_bytes"] == status["totals"]["bytes"] == written
    assert status["disk"] == "ok"
    assert status["filesystem"]["free_bytes"] > 0
    assert process.status_path.stat().st_mode & 0o777 == 0o644


def test_the_drive_is_held_while_it_is_written(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(0.3)
    wait_until(lambda: drives(tmp_path), "the drive's folder")
    vehicle.drive(0.3)
    (drive,) = drives(tmp_path)
    assert layout.is_held(drive)
    vehicle.close()
    process.wait_for(lambda status: not status["connections"])
    wait_until(lambda: not layout.is_held(drive), "it is held no more")


def test_what_gateways_still_send_after_sigterm_is_recorded(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(0.5)
    process.process.send_signal(signal.SIGTERM)
    vehicle.drive(0.4)
    vehicle.close()
    assert process.process.wait(5) == 0
    assert account(drives(tmp_path)[0]) == (vehicle.frames, 0)


def test_it_ends_in_order_from_the_moment_its_socket_is_there(recorder):
    for _ in range(5):
        process = recorder()
        while not process.socket.exists():
            assert process.process.poll() is None, process.errors
        assert process.stop() == 0


def test_the_program_has_a_name_of_its_own_too():
    program = (
        "import sys; from vcu_gateway.cli import recorder;"
        "sys.argv = ['vcu-gateway-recorder', '--help']; recorder()"
    )
    named = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    verb = [sys.executable, "-m", "vcu_gateway", "recorder", "--help"]
    assert named.stdout == subprocess.run(verb, capture_output=True, text=True).stdout
    assert "--keep-free-bytes SIZE" in named.stdout


def test_it_imports_nothing_of_the_gateway():
    program = (
        "import sys; from vcu_gateway.recorder import program;"
        "print([name for name in sys.modules if name.split('.')[0] in"
        " ('can', 'pydantic', 'structlog', 'cantools', 'yaml') or name.startswith('vcu_gateway.')])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    imported = {name.split(".")[1] for name in ast.literal_eval(done.stdout)}
    assert imported == {"recorder", "recording", "errors", "files", "rate_limit", "text", "units"}
