"""The simulated vehicle on a bus: python-can's virtual one, and buses that misbehave."""

import contextlib
import errno
import itertools
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from click.testing import CliRunner

from vcu_gateway import simulator
from vcu_gateway.cli.simulate import simulate
from vcu_gateway.core.codec import Codec
from vcu_gateway.errors import UnavailableError
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.play import Played, open_bus, play

CODEC = Codec(dbc.load(packaged("vcu.dbc")))
IDS = {name: codec.spec.can_id for name, codec in CODEC.by_name.items()}
NAMES = {can_id: name for name, can_id in IDS.items()}
COMMAND = "VCU_PCU1_Command"
PATIENCE_S = 60.0
_numbers = itertools.count()


@pytest.fixture
def channel(request: pytest.FixtureRequest) -> str:
    return f"{request.node.name}-{next(_numbers)}"


@pytest.fixture
def gateway(channel: str) -> Iterator[can.BusABC]:
    """The other end of the bus."""
    with can.Bus(channel, "virtual") as bus:
        yield bus


def command_frame(**values: float) -> can.Message:
    return can.Message(arbitration_id=IDS[COMMAND], data=CODEC.by_name[COMMAND].encode(values))


class InBackground:
    """`play` in a thread; `result` ends it and hands over what it returned or raised."""

    def __init__(self, bus: can.BusABC, **options: Any) -> None:
        self.stop = threading.Event()
        self._bus = bus
        self._options = options
        self._played: Played | None = None
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        nodes = simulator.build(CODEC, time.monotonic_ns())
        try:
            self._played = play(self._bus, nodes, stop=self.stop, **self._options)
        except Exception as error:  # noqa: BLE001 - handed over
            self._error = error

    def result(self) -> Played:
        self.stop.set()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        if self._error is not None:
            raise self._error
        assert self._played is not None
        return self._played


@contextlib.contextmanager
def playing(channel: str, **options: Any) -> Iterator[InBackground]:
    with open_bus("virtual", channel, [IDS[COMMAND], IDS["VCU_PCU2_Command"]]) as bus:
        background = InBackground(bus, **options)
        try:
            yield background
        finally:
            background.result()


def first(bus: can.BusABC, message: str) -> can.Message:
    """The next frame of this message."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        frame = bus.recv(PATIENCE_S)
        if frame is not None and NAMES[frame.arbitration_id] == message:
            return frame
    raise AssertionError(f"no {message} came")


class FakeBus:
    """A bus whose sends and receptions fail as told; without a descriptor.

    Attributes:
        served: set once all of them have failed and some frames were sent.
    """

    def __init__(self, send_errors: list[Exception | None], recv_error: Exception | None = None):
        self._send_errors = deque(send_errors)
        self._recv_error = recv_error
        self.sent: list[can.Message] = []
        self.served = threading.Event()

    def fileno(self) -> int:
        raise NotImplementedError

    def send(self, message: can.Message) -> None:
        error = self._send_errors.popleft() if self._send_errors else None
        if error is not None:
            raise error
        self.sent.append(message)
        if len(self.sent) > 5 and not self._send_errors and self._recv_error is None:
            self.served.set()

    def recv(self, timeout: float) -> None:
        error, self._recv_error = self._recv_error, None
        if error is not None:
            raise error
        threading.Event().wait(timeout)


def play_on(bus: Any, **options: Any) -> Played:
    """Until it has served, or for the duration asked for."""
    nodes = simulator.build(CODEC, time.monotonic_ns())
    stop = threading.Event() if "duration_s" in options else bus.served
    return play(bus, nodes, stop=stop, **{"duration_s": PATIENCE_S, **options})


def test_every_node_speaks_and_status2_answers_a_command(channel: str, gateway: can.BusABC) -> None:
    cyclic = {name for name in IDS if not name.endswith("_Status2") and name[:3] != "VCU"}
    with playing(channel) as background:
        seen = set()
        while seen != cyclic:
            frame = gateway.recv(PATIENCE_S)
            assert frame is not None
            assert frame.is_extended_id
            seen.add(NAMES[frame.arbitration_id])
        gateway.send(command_frame(PowerMode=1))
        assert len(first(gateway, "PCU1_Status2").data) == 8
        played = background.result()
    assert played.received == {COMMAND: 1}
    assert set(played.sent) == cyclic | {"PCU1_Status2"}
    assert not played.lost


def test_a_commanded_throttle_turns_the_motor(channel: str, gateway: can.BusABC) -> None:
    status2 = CODEC.by_name["PCU1_Status2"]
    column = status2.spec.signal_names.index("MotorSpeed")
    throttle = command_frame(PowerMode=2, Throttle=90, SpeedLimit=12000, PowerLimit=60000)
    with playing(channel):
        for _ in range(200):
            gateway.send(throttle)
            answer = first(gateway, "PCU1_Status2")
            if status2.decode(answer.data).values[column] > 50:
                return
    pytest.fail("the motor did not turn")


def test_only_command_frames_reach_the_controllers(channel: str, gateway: can.BusABC) -> None:
    with playing(channel) as background:
        gateway.send(can.Message(arbitration_id=IDS["BMS_Status"], data=bytes(8)))
        gateway.send(can.Message(arbitration_id=IDS[COMMAND], is_remote_frame=True, dlc=8))
        gateway.send(can.Message(arbitration_id=IDS[COMMAND], is_error_frame=True))
        gateway.send(can.Message(arbitration_id=0x7D0, data=bytes(8), is_extended_id=False))
        gateway.send(can.Message(arbitration_id=IDS[COMMAND], data=bytes(7)))
        gateway.send(command_frame())
        first(gateway, "PCU1_Status2")
        assert background.result().received == {COMMAND: 1}


@pytest.mark.clock
def test_the_duration_ends_it(channel: str) -> None:
    with open_bus("virtual", channel, []) as bus:
        nodes = simulator.build(CODEC, time.monotonic_ns())
        played = play(bus, nodes, stop=threading.Event(), duration_s=0.2)
    assert 0.2 <= played.duration_s < PATIENCE_S
    assert 1 <= played.sent["IMU_Acceleration"] <= 0.1 * 1000 * played.duration_s + 1


def test_a_set_stop_ends_it_before_the_first_frame(channel: str) -> None:
    stop = threading.Event()
    stop.set()
    with open_bus("virtual", channel, []) as bus:
        played = play(bus, simulator.build(CODEC, time.monotonic_ns()), stop=stop)
    assert not played.sent


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (can.CanOperationError("Transmit buffer full"), "No buffer space available"),
        (can.CanOperationError("Failed to transmit", errno.ENOBUFS), "No buffer space available"),
        (can.CanOperationError("Failed to transmit", errno.ENETDOWN), "Network is down"),
        (OSError(errno.ENETDOWN, "Network is down"), "Network is down"),
    ],
)
def test_a_bus_that_takes_no_frame_for_a_while_loses_it_and_the_next_goes_out(
    error: Exception, reason: str
) -> None:
    bus = FakeBus([error, error, None])
    played = play_on(bus)
    assert played.lost == {reason: 2}
    assert len(bus.sent) == sum(played.sent.values()) > 0


def test_trouble_is_reported_once_and_its_end_after_a_quiet_second() -> None:
    full = can.CanOperationError("Transmit buffer full")
    notes: list[str] = []
    play_on(FakeBus([full, None, full, None, full]), duration_s=2.5, note=notes.append)
    assert notes == [
        "the bus takes no frames: No buffer space available; trying on",
        "the bus takes frames again",
    ]


def test_a_link_that_goes_down_while_waiting_is_no_lost_frame_and_no_end() -> None:
    played = play_on(FakeBus([], can.CanOperationError("recv", errno.ENETDOWN)))
    assert not played.lost
    assert sum(played.sent.values()) > 1


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENXIO, errno.EBADF])
def test_a_bus_that_has_gone_ends_it_with_a_clear_error(number: int) -> None:
    error = can.CanOperationError("Failed to transmit", number)
    with pytest.raises(UnavailableError, match="the bus has gone"):
        play_on(FakeBus([error]))
    with pytest.raises(UnavailableError, match="the bus has gone"):
        play_on(FakeBus([], error))


def test_the_cause_of_an_error_without_a_number_is_looked_at() -> None:
    error = can.CanOperationError("failed to send via socket")
    error.__cause__ = OSError(errno.ENETDOWN, "Network is down")
    assert play_on(FakeBus([error])).lost == {"Network is down": 1}


@pytest.mark.parametrize(
    ("interface", "bus_name"), [("socketcan", "nosuch0"), ("nosuchinterface", "can0")]
)
def test_a_missing_bus_is_unavailable_and_named(interface: str, bus_name: str) -> None:
    with pytest.raises(UnavailableError, match=bus_name):
        open_bus(interface, bus_name, [IDS[COMMAND]])


class DescriptorBus(FakeBus):
    """A bus with a descriptor, that writes down the time-outs it is asked to keep."""

    def __init__(self) -> None:
        super().__init__([])
        self.readable, self.writer = socket.socketpair()
        self.timeouts: list[float] = []

    def fileno(self) -> int:
        return self.readable.fileno()

    def recv(self, timeout: float) -> None:
        self.timeouts.append(timeout)
        self.readable.recv(1)


def test_no_time_out_is_left_to_the_wall_clock() -> None:
    bus = DescriptorBus()
    bus.writer.send(b"xy")
    with bus.readable, bus.writer:
        played = play_on(bus)
    assert bus.timeouts == [0, 0]
    assert played.sent


def test_the_log_holds_what_was_sent_and_received(
    channel: str, gateway: can.BusABC, tmp_path: Path
) -> None:
    path = tmp_path / "played.log"
    with (
        can.CanutilsLogWriter(path, channel="vcan0") as log,
        playing(channel, log=log) as background,
    ):
        gateway.send(command_frame(Throttle=39))
        first(gateway, "PCU1_Status2")
        played = background.result()
    with can.LogReader(path) as reader:
        frames = list(reader)
    received = [frame for frame in frames if frame.is_rx]
    assert [NAMES[frame.arbitration_id] for frame in received] == [COMMAND]
    assert received[0].data[1] == 100
    assert len(frames) - 1 == sum(played.sent.values())
    # What is received is written when it is seen: a busy machine sees it late.
    stamps_s = [frame.timestamp for frame in frames if not frame.is_rx]
    assert stamps_s == sorted(stamps_s)
    assert stamps_s[0] == pytest.approx(time.time(), abs=60)


def test_the_command_says_what_it_does_and_what_it_did(channel: str, tmp_path: Path) -> None:
    path = tmp_path / "sent.log"
    arguments = ["--interface", "virtual", "--channel", channel, "--duration", "0.3"]
    result = CliRunner().invoke(simulate, [*arguments, "--log", str(path)])
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    begin, end = result.stderr.splitlines()
    assert begin.startswith("playing BMS, IMU, ARD2, PCU1 and PCU2 on virtual ")
    assert "IMU_Acceleration" in end
    assert end.endswith("received 0")
    assert path.read_text(encoding="ascii").count("040AD079") >= 1


@pytest.mark.parametrize(
    "arguments",
    [["--soc", "101"], ["--duration", "0"], ["--battery-speedup", "-1"], ["--seed", "x"]],
)
def test_a_wrong_option_is_refused(arguments: list[str]) -> None:
    assert CliRunner().invoke(simulate, arguments).exit_code == 2


def test_a_log_that_cannot_be_written_is_refused(channel: str, tmp_path: Path) -> None:
    arguments = ["--interface", "virtual", "--channel", channel, "--duration", "0.3"]
    path = tmp_path / "missing" / "sent.log"
    result = CliRunner().invoke(simulate, [*arguments, "--log", str(path)])
    assert result.exit_code == 2
    assert "--log" in result.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(channel: str, number: signal.Signals) -> None:
    program = "from vcu_gateway.cli import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", program, "simulate", "--interface", "virtual", "--channel", channel],
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        assert process.stderr.readline().startswith("playing ")
        process.send_signal(number)
        _, rest = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert rest.startswith("played ")
