"""Gateway and simulated vehicle in one process, shown as a table."""

import threading
import time

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from vcu_gateway import simulator
from vcu_gateway.bus.door import BusSettings, Door, Interface
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.schedule import Tick
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.why import Why
from vcu_gateway.daemon import Daemon
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.play import open_bus, play
from vcu_gateway.view import Picture, render

_REOPEN_MS = 200
_ROOMY_LINES = 34
_PLAIN_COLUMNS = 120


class Demonstration:
    """Runs the gateway on the calling thread and the vehicle beside it."""

    def __init__(
        self,
        interface: Interface,
        channel: str,
        title: str,
        throttle_pct: float,
        battery_speedup: float,
    ) -> None:
        self._title = title
        codec = Codec(dbc.load(packaged("vcu.dbc")))
        demand = ControllerDemand(throttle_pct=throttle_pct, power_mode=PowerMode.NORMAL)
        bench = Settings(bench_demand=demand, auto_arm=True)
        self._gateway = Gateway(codec, bench, time.monotonic_ns())
        settings = BusSettings(interface, channel)
        self._door = Door(settings, codec.identifiers(), self._gateway.intake.receive)
        self._daemon = Daemon(self._gateway, self._door, _REOPEN_MS, self._observe)
        self._nodes = simulator.build(codec, time.monotonic_ns(), battery_speedup=battery_speedup)
        self._vehicle_bus = open_bus(interface, channel, self._nodes.command_ids)
        self._latest: tuple[TickResult, Why] | None = None

    def _observe(self, tick: Tick, result: TickResult) -> None:
        del tick
        self._latest = result, self._gateway.why(result.snapshot.now_ns)

    def run(self, duration_s: float | None) -> None:
        """Until SIGINT, SIGTERM or the end of the duration."""
        stop = threading.Event()
        vehicle = threading.Thread(
            target=play, args=(self._vehicle_bus, self._nodes), kwargs={"stop": stop}
        )
        self._daemon.handle_signals()
        vehicle.start()
        try:
            self._daemon.run(duration_s)
        finally:
            stop.set()
            vehicle.join()
            self._vehicle_bus.shutdown()

    def show_live(self, done: threading.Event, every_s: float) -> None:
        """Fill the terminal with the picture until done, and leave the last one behind."""
        console = Console()
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not done.wait(every_s):
                roomy = console.height >= _ROOMY_LINES
                live.update(self.picture(roomy), refresh=True)
        console.print(self.picture())

    def show_plain(self, done: threading.Event, every_s: float) -> None:
        """Print the picture now and then, for a pipe or a file."""
        console = Console(width=_PLAIN_COLUMNS)
        while not done.wait(every_s):
            console.print(Group(self.picture(), Text()))

    def picture(self, roomy: bool = True) -> RenderableType:
        """What is known now."""
        if self._latest is None:
            return Text(f"{self._title}: waiting for the first tick")
        result, why = self._latest
        return render(
            Picture(
                title=self._title,
                why=why,
                snapshot=result.snapshot,
                commands=result.commands,
                frames=result.frames,
                schedule=self._daemon.schedule,
                sent=self._door.counters.sent,
                rejected={r.value: n for r, n in self._gateway.intake.rejected.items()},
                refused=self._door.counters.refused,
                dropped=self._door.dropped,
            ),
            roomy,
        )

    def summary(self) -> str:
        """One line for the end."""
        schedule = self._daemon.schedule
        return (
            f"{schedule.ticks} ticks, {schedule.skipped} skipped, "
            f"{self._door.counters.sent} command frames sent, "
            f"{self._door.counters.received} frames received"
        )
