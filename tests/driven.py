"""A gateway with its API and a healthy vehicle, on the virtual bus of this process."""

import contextlib
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import can

from tests.unrecorded import unrecorded
from vcu_gateway import config as configuration
from vcu_gateway import simulator
from vcu_gateway.app import Application
from vcu_gateway.client import Client, RefusedError
from vcu_gateway.config.checks import load_protocol
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.why import Explanation
from vcu_gateway.daemon.restart_state import CountedStart
from vcu_gateway.simulator.play import open_bus, play

PATIENCE_S = 60.0


class Driven:
    """The parts, running on threads of their own.

    Attributes:
        file: its configuration file, to be changed and reloaded.
    """

    def __init__(self, folder: Path, config: str = "", always: str = "") -> None:
        """`always` stays in the file through every `configure`."""
        self.socket_path = folder / "control.sock"
        self.file = folder / "gateway.yaml"
        channel = f"driven-{uuid.uuid4()}"
        self._head = (
            f"bus: {{interface: virtual, channel: {channel}}}\n"
            f"api: {{socket_path: {self.socket_path}}}\n{always}"
        )
        self.configure(config)
        loaded = configuration.load(self.file)
        protocol = load_protocol(loaded)
        application = Application(loaded, protocol)
        application.facts.start = CountedStart(3, 1)
        self.loop, self.api = application.loop, application.api
        self.nodes = simulator.build(Codec(protocol), time.monotonic_ns())
        self.other_node = can.Bus(interface="virtual", channel=channel)
        self._vehicle_bus = open_bus("virtual", channel, self.nodes.command_ids)
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(
                name="vehicle",
                target=play,
                args=(self._vehicle_bus, self.nodes),
                kwargs={"stop": self._stop},
            ),
            threading.Thread(name="gateway", target=application.run),
        ]

    def configure(self, config: str) -> None:
        """Write the configuration file."""
        self.file.write_text(unrecorded(self.file.parent, self._head + config))

    def start(self) -> None:
        self.api.open()
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        self.loop.stop("the test is over")
        self._threads[1].join()
        self.api.close()
        self._stop.set()
        self._threads[0].join()
        self._vehicle_bus.shutdown()
        self.other_node.shutdown()

    def client(self) -> Client:
        return Client(self.socket_path)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        wait_until(condition, what, now=self._now)

    def _now(self) -> str:
        """What it says, and which of its threads have ended."""
        ended = [one.name for one in self._threads if not one.is_alive()]
        return f"; {self.loop.gateway.why(time.monotonic_ns()).sentence()}; ended: {ended}"

    def until_mode(self, mode: str) -> None:
        self.until(lambda: self.mode == mode, f"mode {mode}")

    def until_ready(self) -> None:
        """In standby, with nothing left that blocks."""
        self.until_mode("standby")
        self.until(lambda: self.latest_why.blocks == (), "the causes of the start to go")

    @property
    def latest_why(self) -> Explanation:
        latest = self.loop.latest
        assert latest is not None
        return latest.why

    @property
    def mode(self) -> str:
        return self.loop.gateway.supervisor.mode.value

    def throttles(self) -> set[int]:
        """Throttle codes of every command heard since the last call."""
        heard = set()
        while frame := self.other_node.recv(0):
            if frame.arbitration_id in self.nodes.command_ids:
                heard.add(frame.data[1])
        return heard


def armed(client: Client) -> bool:
    """Not yet where a machine that stood still cost the gateway a message."""
    try:
        client.arm()
    except RefusedError:
        return False
    return True


@contextlib.contextmanager
def driven(folder: Path, config: str = "", always: str = "") -> Iterator[Driven]:
    """A running gateway, ended with the block."""
    one = Driven(folder, config, always)
    one.start()
    try:
        yield one
    finally:
        one.end()


def wait_until(
    condition: Callable[[], bool],
    what: str,
    patience_s: float = PATIENCE_S,
    now: Callable[[], str] = str,
) -> None:
    """Poll until true; after patience_s the test fails with what was waited for, and how it is."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"waited {patience_s} s in vain for {what}{now()}"
        time.sleep(0.01)
