"""A simulated vehicle that a test breaks and mends while it drives."""

import functools
import threading
import time
from collections.abc import Iterable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from typing import Any

from tests.faults.driving import PATIENCE_S, BusStand, Driving
from tests.vcan.conftest import Recording
from vcu_gateway import simulator
from vcu_gateway.core.codec import Codec
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator import faults
from vcu_gateway.simulator.nodes import NodeFrame
from vcu_gateway.simulator.play import open_bus, play
from vcu_gateway.simulator.scenario import FAULTS, PROTOCOL
from vcu_gateway.simulator.vehicle import Vehicle

Step = dict[str, Any]
"""As a step of a scenario, without its time: {"fault": "silence", "of": "BMS"}."""

# The inertial unit is nine tenths of the traffic, and the lab has one processor.
QUIET: Step = {"fault": "silence", "of": "IMU"}


class ChangingFault:
    """A fault of the simulator that the test changes while it runs."""

    def __init__(self, codec: Codec, pipe: Connection) -> None:
        self._codec = codec
        self._pipe = pipe
        self._broken: list[faults.Fault] = []

    def next_due_ns(self) -> int:
        return time.monotonic_ns() + 20_000_000

    def due(self, vehicle: Vehicle, now_ns: int) -> Iterable[NodeFrame]:
        if self._pipe.poll():
            self._change(vehicle, self._pipe.recv())
            self._pipe.send(now_ns)
        return ()

    def _change(self, vehicle: Vehicle, steps: list[Step]) -> None:
        for fault in self._broken:
            fault.change(vehicle, False)
        self._broken = [self._fault(step) for step in steps]
        for fault in self._broken:
            fault.change(vehicle, True)

    def _fault(self, step: Step) -> faults.Fault:
        context = {PROTOCOL: self._codec.protocol}
        return (
            FAULTS[step["fault"]]
            .model_validate({"at_s": 0, **step}, context=context)
            .broken(self._codec)
        )

    def transform(self, frame: NodeFrame) -> Iterable[NodeFrame]:
        frames: Iterable[NodeFrame] = (frame,)
        for fault in self._broken:
            frames = [changed for each in frames for changed in fault.transform(each)]
        return frames


def run_vehicle(channel: str, pipe: Connection) -> None:
    """The vehicle, in a process of its own."""
    codec = Codec(dbc.load(packaged("vcu.dbc")))
    fault = ChangingFault(codec, pipe)
    nodes = simulator.build(codec, time.monotonic_ns(), faults=[fault])
    play(open_bus("socketcan", channel, nodes.command_ids), nodes, stop=threading.Event())


class Breaking(Driving):
    """A gateway that drives a vehicle which the test breaks.

    Attributes:
        quiet: what is always broken.
    """

    def __init__(self, stand: BusStand, recording: Recording | None = None) -> None:
        super().__init__(stand, recording=recording)
        self.quiet: list[Step] = [QUIET]
        self._vehicle_process: ForkProcess | None = None
        self._pipe: Connection | None = None

    def start_vehicle(self, scenario: str = "") -> None:
        del scenario
        self._pipe, theirs = Pipe()
        self._vehicle_process = self.stand.run(functools.partial(run_vehicle, self.wire, theirs))
        self.break_with()

    def break_with(self, *steps: Step) -> int:
        """Break it so, and mend all else; when, wall clock, ns: not later than it was done."""
        assert self._pipe is not None
        begun_ns = time.time_ns()
        self._pipe.send([*self.quiet, *steps])
        assert self._pipe.poll(PATIENCE_S), "the vehicle does not answer"
        self._pipe.recv()
        return begun_ns

    def is_well(self) -> bool:
        return self.gateway.popen.poll() is None and bool(
            self._vehicle_process is None or self._vehicle_process.is_alive()
        )
