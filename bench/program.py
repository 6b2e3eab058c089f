"""The gateway under test: `python -m bench.program WAY CONFIG [fifo] [stand-in=FD]`.

WAY is `run` (`vcu-gateway run` as it is), `timed` (the same, with a clock reading before and after
what is measured; prints JSON at its end) or `receive` (bus to store alone, no ticks; says when it
is ready). Nothing is imported early that `run` does not import: a start is timed from here.
"""

import os
import sys
import time
from typing import Any, NoReturn

from bench import on_import, stand_in

_PRIORITY = 40
_PERIOD_S = 0.05
_MANY_FRAMES = 139


def main() -> None:
    way, config, *words = sys.argv[1:]
    options = dict(word.partition("=")[::2] for word in words)
    if "fifo" in options:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    if "stand-in" in options:
        stand_in.for_python_can(int(options["stand-in"]))
        stand_in.for_gateway()
    if way == "receive":
        receive(config)
    found = timed() if way == "timed" else None
    from vcu_gateway.cli import main as command_line

    sys.argv = ["vcu-gateway", "run", "--config", config]
    command_line()
    if found is not None:
        import json

        import vcu_gateway

        print(json.dumps({**found, "source": vcu_gateway.__file__}), flush=True)


def timed() -> dict[str, Any]:
    """Note every tick of this process: when it was due, lateness, processor time (ns), mode.

    Processor time is that of the ticking thread from the snapshot until the last frame was handed
    to the kernel; 0 where none was.
    """
    ticks: list[list[Any]] = []
    clock_ns = time.thread_time_ns
    begun_ns = 0

    def time_due(names: dict[str, Any]) -> None:
        schedule = names["Schedule"]
        due = schedule.due

        def timed_due(self: Any, now_ns: int) -> Any:
            result = due(self, now_ns)
            if result is not None:
                ticks.append([result.deadline_ns, result.lateness_ns, 0, ""])
            return result

        schedule.due = timed_due

    def time_tick(names: dict[str, Any]) -> None:
        gateway = names["Gateway"]
        tick, sent = gateway.tick, gateway.sent

        def timed_tick(self: Any, now_ns: int) -> Any:
            nonlocal begun_ns
            begun_ns = clock_ns()
            result = tick(self, now_ns)
            ticks[-1][3] = result.mode.value
            return result

        def timed_sent(self: Any, *of_frame: Any) -> None:
            sent(self, *of_frame)
            ticks[-1][2] = clock_ns() - begun_ns

        gateway.tick, gateway.sent = timed_tick, timed_sent

    on_import.change("vcu_gateway.core.schedule", time_due)
    on_import.change("vcu_gateway.core.gateway", time_tick)
    return {"ticks": ticks}


def receive(config: str) -> NoReturn:
    """Read the bus as the gateway does, until SIGTERM.

    Where it has no thread for that, the ticking thread reads: before each tick, and in mid-period
    while many frames came.
    """
    import gc
    import threading
    from pathlib import Path

    from vcu_gateway import config as configuration
    from vcu_gateway.app import Application
    from vcu_gateway.config.checks import load_protocol

    parsed = configuration.load(Path(config))
    connection = Application(parsed, load_protocol(parsed)).loop.connection
    gc.disable()  # as the daemon does while it runs
    connection.open()
    print("ready", flush=True)
    while threading.active_count() > 1:
        time.sleep(_PERIOD_S)
    due_s, before = time.monotonic(), 0
    while True:
        received = connection.counters.received
        due_s += _PERIOD_S / 2 if received - before > _MANY_FRAMES else _PERIOD_S
        before = received
        time.sleep(max(0.0, due_s - time.monotonic()))
        connection.read_waiting(time.monotonic_ns())


if __name__ == "__main__":
    main()
