"""Gateway and simulated vehicle in one process, as the child of `vcu-gateway demo`.

Its one argument is a JSON object of `process.DemoOptions`. It writes `process.READY` as the first
line of stdout once its API listens, a line beginning with `process.NOTE` for each step of the
scenario, and a summary as the last. It ends with its stdin, with SIGTERM, or when the duration is
over.
"""

import contextlib
import json
import sys
import threading
import time

from vcu_gateway import config as configuration
from vcu_gateway import simulator
from vcu_gateway.app import Application
from vcu_gateway.client import Client, RefusedError
from vcu_gateway.core.can_pedals import CanPedals
from vcu_gateway.core.causes import Event
from vcu_gateway.core.codec import Codec
from vcu_gateway.daemon import log
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.demo import process
from vcu_gateway.demo.process import NOTE, READY, DemoOptions
from vcu_gateway.errors import GatewayError, Problem, UnavailableError
from vcu_gateway.simulator.play import open_bus, play
from vcu_gateway.simulator.scenario import Scenario

_ARM_EVERY_S = 0.2


def main() -> None:
    """The child: its errors are lines on stderr and an exit code, as everywhere."""
    try:
        run(DemoOptions(**json.loads(sys.argv[1])))
    except GatewayError as error:
        sys.stderr.write("".join(f"error: {problem}\n" for problem in error.problems))
        sys.exit(error.exit_code)


def run(wanted: DemoOptions) -> None:
    writer = log.configure("error", "console")
    config, protocol, scenario = process.load(wanted)
    application = Application(config, protocol, lambda: writer.dropped)
    loop = application.loop
    api_failures: list[Event] = []
    loop.event_log.subscribe(lambda event: _note_api_failure(event, api_failures))
    loop.connection.acquire_lock()
    loop.handle_signals()
    stop = threading.Event()
    with application.api:
        if api_failures:
            remedy = "--socket PATH gives this demo another one"
            raise UnavailableError(Problem(str(api_failures[0].fields["reason"]), "", remedy))
        pedals = configuration.core_settings(config).pedals
        vehicle = _vehicle(wanted, Codec(protocol), scenario, pedals, stop)
        threading.Thread(target=_end_with_stdin, args=(loop,), daemon=True).start()
        if pedals is not None and wanted.has_demand:
            threading.Thread(target=_arm, args=(wanted.socket_path,), daemon=True).start()
        _say(READY)
        vehicle.start()
        try:
            application.run(wanted.duration_s)
        finally:
            stop.set()
            vehicle.join()
            _say(_summary(loop))  # while the API answers: the view never sees it gone


def _note_api_failure(event: Event, failures: list[Event]) -> None:
    """Without its API a vehicle's gateway goes on; a demo would have nothing to show."""
    if event.name == "api_unavailable":
        failures.append(event)


def _vehicle(
    wanted: DemoOptions,
    codec: Codec,
    scenario: Scenario,
    pedals: CanPedals | None,
    stop: threading.Event,
) -> threading.Thread:
    start_ns = time.monotonic_ns()
    nodes = simulator.build(
        codec,
        start_ns,
        **scenario.start.model_dump(),
        faults=scenario.faults(codec, start_ns, lambda sentence: _say(NOTE + sentence)),
        pedals=pedals,
        foot=scenario.foot,
    )
    bus = open_bus(wanted.interface, wanted.channel, nodes.command_ids)

    def run_vehicle() -> None:
        with bus:
            play(bus, nodes, stop=stop)

    return threading.Thread(target=run_vehicle, name="vehicle")


def _arm(socket_path: str) -> None:
    """Arm once, as soon as that can be: pedals do not, and nobody else is there."""
    with Client(socket_path) as client:
        while True:
            why = client.why()
            if why["mode"] == "standby" and not why["blocks"]:  # else a refusal would be an event
                with contextlib.suppress(RefusedError):
                    client.arm()
                    return
            time.sleep(_ARM_EVERY_S)  # nothing tells when arming is possible


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
