"""The programs under test, each a process of its own: `python -m bench.program NAME`.

ours and naive run until SIGTERM; receive-ours and receive-naive measure themselves and end.
All but naive print JSON at the end.
"""

import argparse
import gc
import json
import logging
import os
import socket
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from bench import CHANNEL, DBC

_SOL_CAN_RAW = 101
_PRIORITY = 40

# A test bench that arms itself: the gateway has all its work to do. The traffic's controllers stand
# still; below 15 % that is no controller that does not obey, which would be found in every tick.
_CONFIG = """
bus: {{channel: {channel}{gather}}}
log: {{level: error}}
bench:
  auto_arm: true
  demand: {{bench_use_only: true, throttle_pct: 10}}
"""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("program", choices=["ours", "naive", "receive-ours", "receive-naive"])
    parser.add_argument("--stand-in", type=int, help="file descriptor of the stand-in socket")
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--gather-ms", type=int)
    parser.add_argument("--fifo", action="store_true", help="with the service's policy")
    asked = parser.parse_args()
    if asked.fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    if asked.stand_in is not None:
        stand_in(asked.stand_in)
    gather = "" if asked.gather_ms is None else f", gather_ms: {asked.gather_ms}"
    config = _CONFIG.format(channel=CHANNEL, gather=gather)
    match asked.program:
        case "ours":
            if asked.stand_in is not None:
                stand_in_for_confirm()
            found = ours(config)
        case "naive":
            naive()
        case "receive-ours":
            found = receive_ours(config, asked.seconds)
        case _:
            found = receive_naive(asked.seconds)
    print(json.dumps(found), flush=True)


class _StandIn(socket.socket):
    """An inherited datagram socket that forgives the options only CAN has."""

    def setsockopt(self, level: int, *rest: Any) -> None:
        if level != _SOL_CAN_RAW:
            super().setsockopt(level, *rest)


def stand_in(descriptor: int) -> None:
    """Make python-can open this descriptor in place of a CAN socket."""
    from can.interfaces.socketcan import socketcan

    vars(socketcan).update(
        create_socket=lambda: _StandIn(fileno=descriptor),
        bind_socket=lambda *_: None,
    )
    logging.getLogger("can").setLevel(logging.CRITICAL)


def stand_in_for_confirm() -> None:
    """Only CAN sets MSG_CONFIRM on an own frame that comes back.

    Here the wire sends it back one byte too long, and the kernel's "cut off" flag stands in.
    """
    from vcu_gateway.bus import interface, socketcan

    there = interface.Interface(number=1, is_can=True, up=True, carrier=True, tx_queue_frames=0)
    setattr(interface.Interfaces, "look", lambda *_: there)  # noqa: B010 - mypy refuses to assign a method
    vars(socketcan).update(_FD_FRAME_BYTES=16)
    vars(socket).update(MSG_CONFIRM=socket.MSG_TRUNC)


def ours(config: str) -> dict[str, Any]:
    """`vcu-gateway run` as it is, with a clock reading before and after what is measured."""
    from vcu_gateway.bus.connection import BusConnection
    from vcu_gateway.cli import main as command_line
    from vcu_gateway.core.gateway import Gateway
    from vcu_gateway.core.schedule import Schedule

    found: dict[str, Any] = {
        "first_tick_ns": 0,
        "lateness_ns": [],
        "tick_ns": [],
        "look_ns": [],
        "modes": {},
    }
    read, tick, sent, due = BusConnection.read_waiting, Gateway.tick, Gateway.sent, Schedule.due
    started_ns = 0

    def timed_read(self: BusConnection, until_ns: int) -> bool:
        begun_ns, frames = time.thread_time_ns(), self.counters.received
        done = read(self, until_ns)
        if self.counters.received == frames:
            found["look_ns"].append(time.thread_time_ns() - begun_ns)
        return done

    def timed_tick(self: Gateway, now_ns: int) -> Any:
        nonlocal started_ns
        started_ns = time.thread_time_ns()
        result = tick(self, now_ns)
        found["modes"][result.mode.value] = found["modes"].get(result.mode.value, 0) + 1
        found["tick_ns"].append(0)
        return result

    def timed_sent(self: Gateway, *of_frame: Any) -> None:
        sent(self, *of_frame)
        found["tick_ns"][-1] = time.thread_time_ns() - started_ns

    def timed_due(self: Schedule, now_ns: int) -> Any:
        result = due(self, now_ns)
        if result is not None:
            found["first_tick_ns"] = found["first_tick_ns"] or time.time_ns()
            found["lateness_ns"].append(result.lateness_ns)
        return result

    for owner, name, method in (
        (BusConnection, "read_waiting", timed_read),
        (Gateway, "tick", timed_tick),
        (Gateway, "sent", timed_sent),
        (Schedule, "due", timed_due),
    ):
        setattr(owner, name, method)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "gateway.yaml")
        path.write_text(config)
        os.environ["RUNTIME_DIRECTORY"] = folder
        sys.argv = ["vcu-gateway", "run", "--config", str(path)]
        command_line()
    return found


def naive() -> NoReturn:
    """What one would write first: Notifier, decode_message, a dictionary and time.sleep."""
    import can
    import cantools

    db: Any = cantools.database.load_file(DBC)
    state: dict[int, Any] = {}

    def on_message(msg: can.Message) -> None:
        state[msg.arbitration_id] = db.decode_message(msg.arbitration_id, msg.data)

    commands = [db.get_message_by_name(f"VCU_PCU{n}_Command") for n in (1, 2)]
    values = {signal.name: 0 for signal in commands[0].signals} | {"SpeedLimit": 12000}
    with can.Bus(interface="socketcan", channel=CHANNEL) as bus:
        can.Notifier(bus, [on_message])
        while True:
            for command in commands:
                bus.send(
                    can.Message(
                        arbitration_id=command.frame_id,
                        data=command.encode(values),
                        is_extended_id=True,
                    )
                )
            time.sleep(0.05)


def receive_ours(config: str, seconds: float) -> dict[str, Any]:
    """Socket to store, without ticks."""
    from vcu_gateway import config as configuration
    from vcu_gateway.app import Application
    from vcu_gateway.config.protocol import load_protocol

    parsed = configuration.parse(config, "bench")
    loop = Application(parsed, load_protocol(parsed)).loop
    gc.disable()  # as the daemon does while it runs
    loop.connection.open()
    found = _window(lambda: loop.connection.counters.received, seconds)
    loop.connection.close()
    return found


def receive_naive(seconds: float) -> dict[str, Any]:
    """Socket to a dictionary through cantools."""
    import can
    import cantools

    db: Any = cantools.database.load_file(DBC)
    state: dict[int, Any] = {}
    count = 0

    def on_message(msg: can.Message) -> None:
        nonlocal count
        count += 1
        state[msg.arbitration_id] = db.decode_message(msg.arbitration_id, msg.data)

    with can.Bus(interface="socketcan", channel=CHANNEL) as bus, can.Notifier(bus, [on_message]):
        return _window(lambda: count, seconds)


def _window(frames: Callable[[], int], seconds: float) -> dict[str, Any]:
    """Frames and processor time of the whole process between two instants."""
    while not frames():
        time.sleep(0.01)
    time.sleep(0.3)
    first, first_ns = frames(), time.process_time_ns()
    time.sleep(seconds)
    return {"frames": frames() - first, "cpu_ns": time.process_time_ns() - first_ns}


if __name__ == "__main__":
    main()
