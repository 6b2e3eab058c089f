"""Gateway and simulated vehicle in one process, as the child of `vcu-gateway demo`.

Its one argument is a JSON object of `process.DemoOptions`. It writes the path of the API's socket
as the first line of stdout, a summary as the last, and ends with its stdin, with SIGTERM, or when
the duration is over.
"""

import json
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

from vcu_gateway import config as configuration
from vcu_gateway import simulator
from vcu_gateway.app import Application
from vcu_gateway.config.protocol import check_protocol, load_protocol
from vcu_gateway.core.codec import Codec
from vcu_gateway.daemon import log
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.demo.process import DemoOptions
from vcu_gateway.errors import GatewayError
from vcu_gateway.simulator.play import open_bus, play


def main() -> None:
    """The child: its errors are lines on stderr and an exit code, as everywhere."""
    wanted = DemoOptions(**json.loads(sys.argv[1]))
    folder = Path(tempfile.mkdtemp(prefix="vcu-gateway-demo."))
    try:
        run(wanted, folder)
    except GatewayError as error:
        sys.stderr.write("".join(f"error: {problem}\n" for problem in error.problems))
        sys.exit(error.exit_code)
    finally:
        shutil.rmtree(folder)


def run(wanted: DemoOptions, folder: Path) -> None:
    """Run gateway and vehicle until the end; `folder` holds the API's socket."""
    writer = log.configure("error", "console")
    config = configuration.parse(_config(wanted, folder / "control.sock"), "demo")
    protocol = load_protocol(config)
    check_protocol(config, protocol)
    application = Application(config, protocol, lambda: writer.dropped)
    loop = application.loop
    loop.connection.acquire_lock()
    loop.handle_signals()
    stop = threading.Event()
    vehicle = _vehicle(wanted, Codec(protocol), stop)
    with application.api:
        threading.Thread(target=_end_with_stdin, args=(loop,), daemon=True).start()
        _say(config.api.socket_path)
        vehicle.start()
        try:
            application.run(wanted.duration_s)
        finally:
            stop.set()
            vehicle.join()
            _say(_summary(loop))  # while the API answers: the view never sees it gone


def _config(wanted: DemoOptions, socket_path: Path) -> str:
    """JSON is YAML."""
    demand = {
        "bench_use_only": True,
        "throttle_pct": wanted.throttle_pct,
        "power_mode": "normal",
    }
    return json.dumps(
        {
            "bus": {"interface": wanted.interface, "channel": wanted.channel},
            "bench": {"demand": demand, "auto_arm": True},
            "api": {"socket_path": str(socket_path), "socket_mode": "0600"},
            "recorder": {"socket_path": wanted.recorder_socket},
        }
    )


def _vehicle(wanted: DemoOptions, codec: Codec, stop: threading.Event) -> threading.Thread:
    nodes = simulator.build(codec, time.monotonic_ns(), battery_speedup=wanted.battery_speedup)
    bus = open_bus(wanted.interface, wanted.channel, nodes.command_ids)

    def run_vehicle() -> None:
        with bus:
            play(bus, nodes, stop=stop)

    return threading.Thread(target=run_vehicle, name="vehicle")


def _end_with_stdin(loop: TickLoop) -> None:
    """Stop with the parent: stdin ends however the parent does."""
    sys.stdin.read()
    loop.stop("the view has ended")


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _summary(loop: TickLoop) -> str:
    schedule, counters = loop.schedule, loop.connection.counters
    return (
        f"{schedule.ticks} ticks, {schedule.skipped} skipped, "
        f"{counters.sent} command frames sent, {counters.received} frames received"
    )


if __name__ == "__main__":
    main()
