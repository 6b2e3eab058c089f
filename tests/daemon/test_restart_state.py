"""A latched CUT and the directions, from one process to the next."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.core.simulated_drive import data
from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import ControllerDemand, Demand
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.daemon import restart_state
from vcu_gateway.daemon.events import EventLog
from vcu_gateway.daemon.restart_state import (
    NOTHING,
    KeptState,
    RestartState,
    file_name,
    folder_for,
    other_folders,
    read,
)
from vcu_gateway.protocol import dbc, packaged

CODEC = Codec(dbc.load(packaged("vcu.dbc")))
BUS = BusSettings("socketcan", "vcan0")
MS = 1_000_000
ZERO_TORQUE, POWER_CUT = "0c000000e02e0000", "8c000000e02e0000"
REVERSE = "1c000000e02e0000"
CUT = "emergency stop"


class Process:
    """A gateway without a bus, from its start to whatever end; time goes on over all of them.

    The battery and both motors, which stand, are well.
    """

    now_ns = time.monotonic_ns()
    life = sequence = 0

    def __init__(
        self, folder: Path | None, settings: BusSettings = BUS, others: Sequence[Path] = ()
    ) -> None:
        self.gateway = Gateway(CODEC, Settings(), self.now_ns)
        self.gateway.link_opened(LinkStatus(LinkState.UP, self.now_ns), None, self.now_ns)
        self.event_log = EventLog()
        self.state = RestartState(folder, settings, self.gateway, self.event_log, others)
        self.state.begin()

    def tick(self) -> list[str]:
        Process.now_ns += 50 * MS
        Process.life ^= 1
        self.hear("BMS_Status", {"LifeSignal": self.life})
        for name in ("PCU1_Status2", "PCU2_Status2"):
            self.hear(name)
        result = self.gateway.tick(self.now_ns)
        self.state.before_sending()
        self.kept_before_sending = read(self.state.path) if self.state.path else NOTHING
        for frame in result.frames:
            self.gateway.sent(frame, True, self.now_ns)
            echo = Frame(frame.can_id, frame.data, self.now_ns, own_echo=True)
            self.gateway.receive(echo)
        self.state.observe(result)
        return [frame.data.hex() for frame in result.frames]

    def hear(self, name: str, raws: dict[str, int] | None = None) -> None:
        can_id = CODEC.by_name[name].spec.can_id
        self.gateway.receive(Frame(can_id, data(name, raws), self.now_ns))

    def run(self, seconds: float) -> list[list[str]]:
        """What was sent in each tick that sent anything."""
        return [frames for _ in range(int(seconds * 20)) if (frames := self.tick())]

    def events(self) -> dict[str, int]:
        return {entry.event.name: entry.count for entry in self.event_log.latest(100)}

    @property
    def mode(self) -> Mode:
        return self.gateway.supervisor.mode


def estopped(folder: Path) -> Process:
    process = Process(folder)
    process.run(2)
    process.gateway.requests.emergency_stop()
    assert process.tick() == [POWER_CUT, POWER_CUT]
    return process


def test_a_first_start_begins_with_nothing_and_forward(tmp_path):
    process = Process(tmp_path)
    assert process.run(2)[0] == [ZERO_TORQUE, ZERO_TORQUE]
    assert process.mode is not Mode.FAULT


def test_a_latched_cut_is_latched_again_and_is_in_the_first_frame(tmp_path):
    estopped(tmp_path)
    again = Process(tmp_path)
    assert again.mode is Mode.FAULT
    assert again.tick() == [], "it listens before it talks all the same"
    sent = again.run(2)
    assert sent
    assert {data for frames in sent for data in frames} == {POWER_CUT}
    assert again.events()["cut_kept"] == 1


def test_it_is_latched_however_often_the_process_starts_again_and_its_reason_stays(tmp_path):
    estopped(tmp_path)
    reasons = set()
    for _ in range(4):
        process = Process(tmp_path)
        process.run(1.5)
        assert process.gateway.supervisor.latch is not None
        reasons.add(process.gateway.supervisor.latch.reason)
    (reason,) = reasons
    assert reason.startswith("before this start: ")
    assert CUT in reason


def test_an_orderly_end_keeps_it(tmp_path):
    process = estopped(tmp_path)
    process.gateway.requests.terminate()
    process.run(0.5)
    assert process.gateway.finished
    assert Process(tmp_path).mode is Mode.FAULT


@pytest.mark.parametrize("in_one_tick", [True, False])
def test_a_cut_of_the_last_ticks_of_an_orderly_end_is_kept(tmp_path, in_one_tick):
    process = Process(tmp_path)
    process.run(2)
    process.gateway.requests.terminate()
    if not in_one_tick:
        process.tick()
    process.gateway.requests.emergency_stop()
    while not process.gateway.finished:
        process.tick()
    assert Process(tmp_path).mode is Mode.FAULT


def test_a_service_reset_ends_it_and_a_drivers_does_not(tmp_path):
    estopped(tmp_path)
    process = Process(tmp_path)
    process.run(3)
    requests = process.gateway.requests
    assert not requests.reset(FaultClass.DRIVER, process.now_ns).granted
    process.tick()
    assert Process(tmp_path).mode is Mode.FAULT
    assert requests.reset(FaultClass.SERVICE, process.now_ns).granted
    process.tick()
    again = Process(tmp_path)
    assert again.mode is not Mode.FAULT
    assert again.run(2)[0] == [ZERO_TORQUE, ZERO_TORQUE]


def test_a_fault_that_the_driver_may_reset_does_not_survive(tmp_path):
    process = Process(tmp_path)
    process.run(2)
    process.gateway.receive(Frame(0x0008A755, bytes(8), process.now_ns))
    process.tick()
    assert process.mode is Mode.FAULT
    assert Process(tmp_path).mode is not Mode.FAULT


def reversed_(folder: Path) -> Process:
    """Both motors stand, and reverse was asked for and applied."""
    process = Process(folder)
    process.run(2)
    asked = ControllerDemand(motor_reverse=True)
    demand = Demand("driver", 1, 1000, {"PCU1": asked, "PCU2": asked})
    assert process.gateway.requests.offer(demand, process.now_ns).granted
    assert process.tick() == [REVERSE, REVERSE]
    return process


def test_the_applied_direction_is_kept_where_no_controller_echoes_one(tmp_path):
    reversed_(tmp_path)
    assert Process(tmp_path).run(2)[0] == [REVERSE, REVERSE]


def test_a_start_that_sent_nothing_leaves_the_direction_to_the_next(tmp_path):
    reversed_(tmp_path)
    assert Process(tmp_path).run(0.5) == []
    assert Process(tmp_path).run(2)[0] == [REVERSE, REVERSE]


def test_what_the_controllers_echo_before_the_first_frame_wins(tmp_path):
    reversed_(tmp_path)
    process = Process(tmp_path)
    process.hear("PCU1_Status1", {"MotorReverse": 0})
    assert process.run(2)[0] == [ZERO_TORQUE, REVERSE]


def offer(process: Process, **asked: Any) -> None:
    Process.sequence += 1
    both = dict.fromkeys(("PCU1", "PCU2"), ControllerDemand(**asked))
    demand = Demand("driver", Process.sequence, 1000, both)
    assert process.gateway.requests.offer(demand, process.now_ns).granted


def armed(folder: Path) -> Process:
    process = Process(folder)
    process.run(3)
    offer(process)
    process.run(0.25)
    answer = process.gateway.requests.arm(process.now_ns)
    assert answer.granted, answer.sentence
    return process


def times_written(process: Process, seconds: float) -> int:
    """In ticks, by the file's number and time."""
    assert process.state.path is not None
    seen = set()
    for _ in range(int(seconds * 20)):
        offer(process)
        process.tick()
        found = process.state.path.stat()
        seen.add((found.st_ino, found.st_mtime_ns))
    return len(seen) - 1


def test_it_is_tried_each_second_but_never_in_active(tmp_path):
    assert times_written(estopped(tmp_path), 3.1) == 3
    with_service = Process(tmp_path)
    assert times_written(with_service, 3.1) == 3
    for path in tmp_path.iterdir():
        path.unlink()
    process = armed(tmp_path)
    assert times_written(process, 3.1) == 0
    assert process.mode is Mode.ACTIVE


def arming(process: Process) -> str:
    return process.gateway.requests.arm(process.now_ns).sentence


def test_nobody_can_arm_while_it_cannot_be_kept(tmp_path):
    folder = tmp_path / "nowhere"
    process = Process(folder)
    process.run(3)
    offer(process)
    process.run(0.25)
    assert arming(process) == "the restart state cannot be kept: No such file or directory"
    folder.mkdir()
    offer(process)
    process.tick()
    assert arming(process) == ""


def test_nobody_can_arm_from_the_next_second_on_in_which_it_cannot_be_kept(tmp_path):
    (tmp_path / "here").mkdir()
    process = Process(tmp_path / "here")
    process.run(3)
    (tmp_path / "here").rename(tmp_path / "gone")
    process.run(1)
    offer(process)
    process.run(0.25)
    assert arming(process) == "the restart state cannot be kept: No such file or directory"


def test_nobody_can_arm_without_a_folder_but_on_a_virtual_bus():
    for settings, sentence in (
        (BUS, "the restart state cannot be kept: no folder for it can be written by this user"),
        (BusSettings("virtual", "x"), ""),
    ):
        process = Process(None, settings)
        process.run(3)
        offer(process)
        process.run(0.25)
        assert arming(process).startswith(sentence)
        assert (process.gateway.mode is Mode.ACTIVE) is (sentence == "")


def alarms(process: Process) -> list[str]:
    return [str(held.finding) for held in process.gateway.why(process.now_ns).alarms]


def test_a_failure_in_active_is_an_alarm_and_is_tried_again_after_the_drive(tmp_path):
    (tmp_path / "here").mkdir()
    process = armed(tmp_path / "here")
    (tmp_path / "here").rename(tmp_path / "gone")
    process.run(0.5)
    assert not any("restart state" in one for one in alarms(process)), "it is not tried"
    offer(process, motor_reverse=True)
    process.run(0.15)
    (alarm,) = [one for one in alarms(process) if "restart state" in one]
    assert alarm == "restart state not kept (No such file or directory): alarm"
    assert process.mode is Mode.ACTIVE
    (tmp_path / "gone").rename(tmp_path / "here")
    process.run(0.5)
    assert process.state.path is not None
    assert not any(read(process.state.path).reverse.values()), "once, in ACTIVE"
    process.gateway.requests.disarm(process.now_ns)
    process.tick()
    assert all(read(process.state.path).reverse.values())
    process.run(1.2)
    assert not any("restart state" in one for one in alarms(process))


# The order: kept, then answered; kept, then sent.


@pytest.fixture
def quick(monkeypatch):
    """However slow this machine is."""
    monkeypatch.setattr(restart_state, "_QUICK_NS", 10**12)


@pytest.mark.usefixtures("quick")
def test_a_granted_emergency_stop_is_latched_though_no_tick_came_after_it(tmp_path):
    process = Process(tmp_path)
    process.run(2)
    process.gateway.requests.emergency_stop()
    process.state.keep_emergency_stop(0)
    again = Process(tmp_path)
    assert again.mode is Mode.FAULT
    latch = again.gateway.supervisor.latch
    assert latch is not None
    assert latch.reason == "before this start: emergency stop requested: cut"


def cut_by_the_battery(process: Process) -> None:
    process.hear("BMS_Status", {"LifeSignal": process.life, "InternalFault": 1})
    process.tick()


@pytest.mark.usefixtures("quick")
def test_a_new_cut_is_kept_before_its_first_frame_with_its_reason(tmp_path):
    process = Process(tmp_path)
    process.run(2)
    cut_by_the_battery(process)
    assert process.kept_before_sending.cut is not None
    assert "InternalFault" in process.kept_before_sending.cut


@pytest.mark.usefixtures("quick")
def test_a_cut_while_stopping_is_kept_before_its_first_frame(tmp_path):
    process = Process(tmp_path)
    process.run(2)
    process.gateway.requests.terminate()
    process.tick()
    assert process.mode is Mode.STOPPING
    cut_by_the_battery(process)
    assert process.kept_before_sending.cut is not None


def test_where_the_last_write_was_slow_the_frames_go_first(tmp_path, monkeypatch):
    process = Process(tmp_path)
    process.run(2)
    monkeypatch.setattr(restart_state, "_QUICK_NS", 0)
    process.gateway.requests.emergency_stop()
    process.state.keep_emergency_stop(0)
    assert read(process.state.path) == process.kept_before_sending
    assert process.tick() == [POWER_CUT, POWER_CUT]
    assert process.kept_before_sending.cut is None
    assert read(process.state.path).cut == "emergency stop requested: cut"


@pytest.mark.parametrize(("first_ns", "kept"), [(2 * MS - 1, True), (2 * MS, False)])
def test_a_stop_waits_for_what_took_less_than_2_ms_in_one_of_three_times(tmp_path, first_ns, kept):
    process = Process(tmp_path)
    process.run(2)
    process.state._took_ns.extend((first_ns, 9 * MS, 9 * MS))  # as if they had taken so long
    process.gateway.requests.emergency_stop()
    process.tick()
    assert (process.kept_before_sending.cut is not None) is kept


def test_a_slow_write_has_the_time_until_the_tick_that_sends_the_stop(tmp_path, monkeypatch):
    monkeypatch.setattr(restart_state, "_QUICK_NS", 0)
    process = Process(tmp_path)
    process.run(2)
    process.gateway.requests.emergency_stop()
    process.state.keep_emergency_stop(10**12)
    assert Process(tmp_path).mode is Mode.FAULT


@pytest.mark.usefixtures("quick")
def test_where_the_last_write_failed_the_frames_go_first(tmp_path):
    (tmp_path / "here").mkdir()
    process = Process(tmp_path / "here")
    process.run(2)
    (tmp_path / "here").rename(tmp_path / "gone")
    process.run(1)
    (tmp_path / "gone").rename(tmp_path / "here")
    process.gateway.requests.emergency_stop()
    process.state.keep_emergency_stop(0)
    assert process.tick() == [POWER_CUT, POWER_CUT]
    assert process.kept_before_sending.cut is None
    assert Process(tmp_path / "here").mode is Mode.FAULT


def test_an_emergency_stop_that_cannot_be_kept_is_sent_all_the_same(tmp_path):
    (tmp_path / "here").mkdir()
    process = Process(tmp_path / "here")
    process.run(2)
    (tmp_path / "here").rename(tmp_path / "gone")
    process.gateway.requests.emergency_stop()
    process.state.keep_emergency_stop(0)
    assert process.tick() == [POWER_CUT, POWER_CUT]
    assert process.events()["restart_state_unwritten"] == 1


def test_another_boots_file_says_nothing(tmp_path, monkeypatch):
    estopped(tmp_path)
    boot = tmp_path / "boot_id"
    boot.write_text("f" * 36 + "\n")
    monkeypatch.setattr(restart_state, "_BOOT_ID", boot)
    assert Process(tmp_path).mode is not Mode.FAULT


def test_where_the_number_of_the_boot_is_hidden_the_file_counts(tmp_path, monkeypatch):
    estopped(tmp_path)
    monkeypatch.setattr(restart_state, "_BOOT_ID", tmp_path / "hidden")
    assert Process(tmp_path).mode is Mode.FAULT
    Process(tmp_path).run(2)
    monkeypatch.undo()
    assert Process(tmp_path).mode is Mode.FAULT


@pytest.mark.parametrize(
    "text",
    [
        "",
        "BOOT",
        "BOOT\n{",
        "BOOT\n[]",
        "BOOT\nnull",
        'BOOT\n{"cut": null}',
        'BOOT\n{"cut": 1, "reverse": {}}',
        'BOOT\n{"cut": null, "reverse": {"PCU1": 1}}',
        'BOOT\n{"cut": null, "reverse": {"PCU3": true}}',
        'BOOT\n{"cut": null, "reverse": []}',
        "nonsense",
        "\udcff\udcfe",
    ],
)
def test_a_file_that_is_not_understood_is_a_latched_cut(tmp_path, text):
    path = tmp_path / file_name("vcan0")
    contents = text.replace("BOOT", restart_state.boot_id()).encode(errors="surrogateescape")
    path.write_bytes(contents)
    process = Process(tmp_path)
    assert process.mode is Mode.FAULT
    assert process.gateway.supervisor.latch is not None
    assert str(path) in process.gateway.supervisor.latch.reason
    assert process.run(2)[0] == [POWER_CUT, POWER_CUT]


def test_what_is_no_file_is_a_latched_cut_too(tmp_path):
    (tmp_path / file_name("vcan0")).mkdir()
    assert Process(tmp_path).mode is Mode.FAULT


def test_a_well_formed_file_is_read_as_written(tmp_path):
    path = tmp_path / "state"
    text = '{"cut": "hot", "reverse": {"PCU1": true, "PCU2": false}}'
    path.write_text(f"{restart_state.boot_id()}\n{text}\n")
    assert read(path) == KeptState("hot", {"PCU1": True, "PCU2": False})
    assert read(tmp_path / "none") == NOTHING


def test_each_channel_has_a_file_of_its_own(tmp_path):
    estopped(tmp_path)
    assert Process(tmp_path, BusSettings("socketcan", "vcan1")).mode is not Mode.FAULT
    assert "/" not in file_name("../x/y")
    assert file_name("vcan0").endswith(f"-{os.stat('/proc/self/ns/net').st_ino}")


def test_a_folder_that_cannot_be_written_is_reported_once_and_nothing_else_happens(tmp_path):
    process = Process(tmp_path / "nowhere")
    assert process.run(2)[0] == [ZERO_TORQUE, ZERO_TORQUE]
    process.gateway.requests.emergency_stop()
    assert process.run(2)[0] == [POWER_CUT, POWER_CUT]
    assert process.events()["restart_state_unwritten"] == 1
    (tmp_path / "nowhere").mkdir()
    process.tick()
    assert Process(tmp_path / "nowhere").mode is Mode.FAULT


def test_nothing_is_written_through_a_link_in_the_way(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    (tmp_path / f"{file_name('vcan0')}.new").symlink_to(elsewhere)
    process = Process(tmp_path)
    process.run(2)
    assert not elsewhere.exists()
    assert process.events()["restart_state_unwritten"] == 1


def test_without_a_folder_it_is_reported_but_for_a_virtual_bus():
    process = Process(None)
    process.run(2)
    assert process.events()["restart_state_unwritten"] == 1
    process = Process(None, BusSettings("virtual", "x"))
    process.run(2)
    assert "restart_state_unwritten" not in process.events()


@pytest.mark.parametrize("own", [True, False])
def test_a_cut_that_another_run_kept_elsewhere_is_latched_until_a_reset(tmp_path, own):
    elsewhere, mine = tmp_path / "service", tmp_path / "user"
    for folder in (elsewhere, mine):
        folder.mkdir()
    estopped(elsewhere)
    process = Process(mine if own else None, others=[elsewhere])
    assert process.mode is Mode.FAULT
    process.run(3)
    assert process.events()["cut_kept"] == 1
    assert process.gateway.requests.reset(FaultClass.SERVICE, process.now_ns).granted
    process.tick()
    assert Process(mine, others=[elsewhere]).mode is not Mode.FAULT


def test_the_directions_of_another_run_elsewhere_stay_there(tmp_path):
    elsewhere, mine = tmp_path / "service", tmp_path / "user"
    for folder in (elsewhere, mine):
        folder.mkdir()
    Process(elsewhere).run(2)
    (left,) = elsewhere.iterdir()
    before = left.read_text()
    Process(mine, others=[elsewhere]).run(2)
    assert left.read_text() == before


# Where.


def test_a_cut_is_looked_for_wherever_another_run_may_have_kept_it(places):
    mine = places / "run" / "vcu-gateway"
    instance, temporary = places / "run" / "vcu-gateway-vcan0", places / "tmp"
    temporary /= f"vcu-gateway-{os.geteuid()}"
    for folder in (mine, instance, places / "user" / "vcu-gateway"):
        folder.mkdir()
    temporary.mkdir(0o700)
    others = [instance, places / "user" / "vcu-gateway", temporary]
    assert other_folders(BUS, mine) == others
    assert other_folders(BusSettings("virtual", "x"), None) == []
    temporary.chmod(0o755)
    assert other_folders(BUS, instance) == [mine, others[1]]


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A machine of the test's own, on which everything can be written."""
    for name in ("run", "user", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(restart_state, "_RUN", tmp_path / "run" / "vcu-gateway")
    monkeypatch.setattr(restart_state, "_TEMPORARY", tmp_path / "tmp")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    return tmp_path


def without_run(places: Path) -> None:
    (places / "run").rmdir()


def test_a_services_own_folder_comes_first_and_a_virtual_bus_has_none(places):
    assert folder_for(BUS, places) == places
    assert folder_for(BusSettings("virtual", "x"), places) is None


@pytest.mark.parametrize("interface", ["socketcan", "udp_multicast"])
def test_else_it_is_the_first_that_can_be_written(places, monkeypatch, interface):
    settings = BusSettings(interface, "x")
    assert folder_for(settings, None) == places / "run" / "vcu-gateway"
    (places / "run" / "vcu-gateway").rmdir()
    without_run(places)
    assert folder_for(settings, None) == places / "user" / "vcu-gateway"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    own = places / "tmp" / f"vcu-gateway-{os.geteuid()}"
    assert folder_for(settings, None) == own
    assert own.stat().st_mode & 0o777 == 0o700
    assert folder_for(settings, None) == own, "the second time too"


@pytest.mark.parametrize("squatted", ["open", "link", "file", "another's"])
def test_a_folder_among_others_that_is_not_ours_alone_is_not_used(places, monkeypatch, squatted):
    without_run(places)
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    own = places / "tmp" / f"vcu-gateway-{os.geteuid()}"
    if squatted == "open":
        own.mkdir(0o755)
    elif squatted == "link":
        (places / "user").chmod(0o700)
        own.symlink_to(places / "user")
    elif squatted == "file":
        own.touch(0o700)
    elif os.geteuid() == 0:
        own.mkdir(0o700)
        os.chown(own, 12345, 12345)
    else:
        pytest.skip("only root can give a folder to somebody else")
    assert folder_for(BUS, None) is None
