"""The running loop on the virtual bus: ticks, links and a safe end."""

import gc
import threading
import time
import uuid

import can
import pytest

from vcu_gateway import simulator
from vcu_gateway.bus.door import BusSettings, Door
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.daemon import Daemon
from vcu_gateway.simulator.play import open_bus, play

COMMANDS = (0x0008A7D0, 0x0008A8D0)
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")


class Rig:
    """A daemon on its own virtual channel, and what another node hears of it."""

    def __init__(self, codec, settings: Settings) -> None:
        self.channel = f"daemon-{uuid.uuid4()}"
        self.codec = codec
        self.gateway = Gateway(codec, settings, 0)
        self.door = Door(
            BusSettings("virtual", self.channel), codec.identifiers(), self.gateway.intake.receive
        )
        self.modes: list[Mode] = []
        self.daemon = Daemon(self.gateway, self.door, 50, self._observe)
        self.ear = can.Bus(interface="virtual", channel=self.channel)

    def _observe(self, tick, result) -> None:
        self.modes.append(result.mode)

    def heard(self) -> list[can.Message]:
        frames = []
        while frame := self.ear.recv(0):
            frames.append(frame)
        return frames


@pytest.fixture
def rig(codec):
    rigs = []

    def make(settings: Settings | None = None) -> Rig:
        rigs.append(Rig(codec, settings or Settings()))
        return rigs[-1]

    yield make
    for one in rigs:
        one.ear.shutdown()


def test_it_listens_for_a_second_and_then_sends_both_frames_every_tick(rig):
    one, start_s = rig(), time.time()
    one.daemon.run(duration_s=1.5)
    schedule = one.daemon.schedule
    assert schedule.ticks + schedule.skipped == 30 + 3, "three more end it safely"
    assert one.daemon.silent_ticks <= 21
    sent = schedule.ticks - one.daemon.silent_ticks
    frames = one.heard()
    assert frames[0].timestamp - start_s >= 1.0
    assert [frame.arbitration_id for frame in frames] == list(COMMANDS) * sent
    assert {bytes(frame.data) for frame in frames} == {ZERO_TORQUE}
    assert one.door.counters.sent == 2 * sent
    for count in one.gateway.intake.confirmed.values():
        assert sent - 1 <= count <= sent, "the echo of the last frame may come after the end"


def test_a_stop_ends_with_three_safe_frames_for_each_controller(rig):
    one = rig()
    threading.Timer(1.3, one.daemon.stop, ["SIGTERM"]).start()
    one.daemon.run()
    assert one.modes[-3:] == [Mode.STOPPING] * 3
    assert Mode.STOPPING not in one.modes[:-3]
    assert {bytes(frame.data) for frame in one.heard()[-6:]} == {ZERO_TORQUE}


def test_a_healthy_vehicle_is_driven_by_an_auto_armed_bench_demand(rig, codec):
    one = rig(Settings(bench_demand=ControllerDemand(throttle_pct=20), auto_arm=True))
    nodes = simulator.build(codec, time.monotonic_ns())
    vehicle_bus, stop = open_bus("virtual", one.channel, nodes.command_ids), threading.Event()
    vehicle = threading.Thread(target=play, args=(vehicle_bus, nodes), kwargs={"stop": stop})
    vehicle.start()
    one.daemon.run(duration_s=5)
    stop.set()
    vehicle.join()
    vehicle_bus.shutdown()
    order = list(dict.fromkeys(one.modes))
    assert order == [Mode.STARTING, Mode.STANDBY, Mode.ACTIVE, Mode.STOPPING]
    throttles = {f.data[1] for f in one.heard() if f.arbitration_id == COMMANDS[0]}
    assert max(throttles) == 51


def test_a_lost_link_is_opened_again_and_is_unarmed(rig):
    one = rig()
    threading.Timer(1.2, lambda: one.door._on_lost("unplugged")).start()
    one.daemon.run(duration_s=2.5)
    assert one.modes[-4] is Mode.STARTING
    assert one.door.counters.refused.get("closed", 0) <= 4
    assert one.door.counters.sent >= 40, "frames leave again soon"


def test_an_interface_that_is_missing_is_waited_for_without_blocking_the_ticks(codec):
    gateway = Gateway(codec, Settings(), 0)
    door = Door(BusSettings("socketcan", "nocan9"), codec.identifiers(), gateway.intake.receive)
    daemon = Daemon(gateway, door, 50)
    daemon.run(duration_s=0.5)
    assert daemon.schedule.ticks + daemon.schedule.skipped >= 10
    assert door.counters.sent == 0


def test_the_garbage_collector_is_as_before_afterwards(rig):
    one = rig()
    one.daemon.run(duration_s=0.1)
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_a_frame_is_not_sent_half_a_period_after_its_tick(rig, monkeypatch):
    one = rig()
    send, held_up = one.door.send, []

    def held_up_once(frame):
        taken = send(frame)
        if not held_up:
            held_up.append(frame.controller)
            time.sleep(0.03)
        return taken

    monkeypatch.setattr(one.door, "send", held_up_once)
    one.daemon.run(duration_s=1.3)
    assert held_up == ["PCU1"]
    assert one.door.counters.refused["late"] >= 1
    assert [frame.arbitration_id for frame in one.heard()][:2] == [COMMANDS[0], COMMANDS[0]]
