"""Gateway and simulated vehicle as a process of their own, told by lines of JSON what to do.

usage: python -m tests.web.gateway_program FOLDER [CONFIG]. Each line of stdin is a command, each
line of stdout its answer; the first says that it is ready. The frames of the bus are stamped when
they arrive at a node of their own.
"""

import contextlib
import errno
import json
import random
import sys
import threading
import time
from pathlib import Path
from typing import Any

import can

from tests.driven import Driven
from vcu_gateway.client import Client, RefusedError
from vcu_gateway.core import calls
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.simulator.nodes import NodeFrame

COMMANDS = {0x0008A7D0: "PCU1", 0x0008A8D0: "PCU2"}
STEERING_ID = 0x040AD092
POWER_CUT = 0x80


class Bus(can.Listener):
    """What another node hears: the first POWER_CUT of each controller, wall clock."""

    def __init__(self) -> None:
        self.cut: dict[str, float] = {}

    def on_message_received(self, message: can.Message) -> None:
        name = COMMANDS.get(message.arbitration_id)
        if name and message.data[0] & POWER_CUT:
            self.cut.setdefault(name, time.time())


class Program:
    """The gateway, its vehicle, and what a test asks of them."""

    def __init__(self, folder: Path, config: str) -> None:
        self.driven = Driven(folder, config)
        self.silenced: set[str] = set()
        self._deaf: dict[str, bytes | None] = {}
        self._lateness_us: list[float] = []
        self.driven.loop.add_observer(self._note_lateness)
        self.driven.nodes._transforms += (self._unless_silenced, self._as_before_where_deaf)
        self.bus = Bus()
        self.notifier = can.Notifier([self.driven.other_node], [self.bus])
        self._pedals: Any = None
        self._steering = Steering(self.driven)

    def handle(self, name: str, arguments: list[Any]) -> Any:
        return getattr(self, name)(*arguments)

    def mode(self) -> str:
        return self.driven.mode

    def drive(self, throttle_pct: float = 20.0) -> str:
        """Arm and demand, until `park`; also where a machine that stood still ended a drive."""
        self.demand_nothing()
        with self.driven.client() as client:
            self.driven.until(lambda: self._is_active(client), "active")
        self._pedals.set(throttle_pct=throttle_pct)
        return self.driven.mode

    def _is_active(self, client: Client) -> bool:
        if self.driven.mode != "active" and self._is_ready(client):
            with contextlib.suppress(RefusedError):
                client.arm()
        return self.driven.mode == "active"

    def demand_nothing(self) -> None:
        """A driver who has the pedals and asks for nothing, so that arming is possible."""
        self.park()
        self._pedals = (
            Client(self.driven.socket_path).demand("driver", ttl_ms=1000, hold_s=None).__enter__()
        )

    def park(self) -> None:
        if self._pedals is not None:
            self._pedals.release()
            self._pedals = None

    def cuts(self) -> dict[str, float]:
        """When POWER_CUT was first on the bus, and forget it."""
        cut, self.bus.cut = self.bus.cut, {}
        return cut

    def reset(self) -> str:
        """In standby with nothing that blocks, also out of a latched fault."""
        with self.driven.client() as client:
            self.driven.until(lambda: self._is_ready(client), "standby")
        self.bus.cut = {}
        return self.driven.mode

    def mend(self) -> str:
        """The same without the API, which an attack keeps busy."""
        self.driven.until(self._is_mended, "standby")
        self.bus.cut = {}
        return self.driven.mode

    def _is_mended(self) -> bool:
        self.driven.loop.work_queue.post(self._reset)
        return self.driven.mode == "standby" and not self.driven.latest_why.blocks

    def _reset(self) -> None:
        self.driven.loop.gateway.apply(calls.Reset(FaultClass.SERVICE, time.monotonic_ns()))

    def _is_ready(self, client: Client) -> bool:
        if self.driven.mode == "fault":
            with contextlib.suppress(RefusedError):
                client.reset("service")
        return self.driven.mode == "standby" and not self.driven.latest_why.blocks

    def _note_lateness(self, result: object) -> None:
        self._lateness_us.append(self.driven.loop.schedule.recent_lateness_ns[-1] / 1000)

    def lateness_us(self) -> list[float]:
        """Of each tick since the last time that this was asked."""
        noted, self._lateness_us = self._lateness_us, []
        return noted

    def ticks(self) -> dict[str, Any]:
        """Counts, and what was said of the latest that were skipped."""
        with self.driven.client() as client:
            events = client.events()["events"]
            said = [one["fields"] for one in events if one["name"] == "ticks_skipped"]
            return {**client.health()["ticks"], "said": said[:1]}

    def _unless_silenced(self, frame: NodeFrame) -> tuple[NodeFrame, ...]:
        return () if frame.message in self.silenced else (frame,)

    def silence(self, *messages: str) -> None:
        """These are not sent any more, by nobody."""
        self.silenced = set(messages)

    def _as_before_where_deaf(self, frame: NodeFrame) -> tuple[NodeFrame, ...]:
        if frame.message in self._deaf:
            kept = self._deaf[frame.message] = self._deaf[frame.message] or frame.data
            frame = frame._replace(data=kept)
        return (frame,)

    def deafen(self, *controllers: str) -> None:
        """These go on as they did, whatever they are commanded, and say so; the others obey."""
        self._deaf = {f"{name}_Status1": None for name in controllers}

    def interface(self, how: str) -> None:
        """`whole`; `away`, which takes frames that never come back; or `full`, which takes none."""
        bus: Any = self.driven.loop.connection._sending_bus
        library = bus._library_bus
        library.receive_own_messages = how != "away"
        library.__dict__.pop("send", None)
        if how == "full":
            library.send = _take_none

    def steer(self, count: int) -> list[tuple[float, float]]:
        """Steering angles that no other node sends: the wall clock and the angle of each."""
        self.silenced = {"ARD2_SteeringWheel"}
        sent = self._steering.send(count)
        self.silenced = set()
        return sent


def _take_none(message: can.Message, timeout: float | None = None) -> None:
    raise can.CanOperationError("Transmit buffer full", errno.ENOBUFS)


class Steering:
    """The ARD2's frame, with another angle each time, at times that no clock of ours knows."""

    def __init__(self, driven: Driven) -> None:
        self._driven = driven
        self._raw = 30_000

    def send(self, count: int) -> list[tuple[float, float]]:
        sent = []
        for _ in range(count):
            time.sleep(random.uniform(0.08, 0.14))
            self._raw = self._raw + 7 if self._raw < 60_000 else 1000
            data = self._raw.to_bytes(2, "little") + bytes(6)
            message = can.Message(arbitration_id=STEERING_ID, data=data, is_extended_id=True)
            sent.append((time.time(), round(self._raw * 0.003 - 90, 3)))
            self._driven.other_node.send(message)
        return sent


def main() -> None:
    folder, config = Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else ""
    answers = sys.stdout
    sys.stdout = sys.stderr
    program = Program(folder, config)
    program.driven.start()
    program.driven.until_ready()
    threading.excepthook = lambda args: sys.stderr.write(f"{args}\n")
    answers.write('"ready"\n')
    answers.flush()
    for line in sys.stdin:
        name, arguments = json.loads(line)
        try:
            value = {"value": program.handle(name, arguments)}
        except Exception as error:  # noqa: BLE001 - the test is told
            value = {"error": repr(error)}
        answers.write(json.dumps(value) + "\n")
        answers.flush()
    program.park()
    program.notifier.stop()
    program.driven.end()


if __name__ == "__main__":
    main()
