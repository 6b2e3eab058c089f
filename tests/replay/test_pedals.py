"""A recorded drive with pedals on CAN: replayed to the byte, and with other pedals."""

from pathlib import Path

import pytest

from tests.core.pedal_node import MS, pressed
from tests.core.pedal_node import frame_data as position
from tests.replay.drives import SimulatedDrive
from tests.replay.ran import replay, what_if
from vcu_gateway.core.can_pedals import checksum_of
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.supervisor import Mode

EXAMPLES = Path(__file__).parents[2] / "config" / "examples"
CONFIG = """
pedals:
  can:
    message: Pedals_Position
    throttle: {signal: Throttle1, released: 0.625, pressed: 3.75}
    throttle_track2: {signal: Throttle2, released: 0.3125, pressed: 1.875}
    brake: {signal: BrakePressure, released: 0.5, pressed: 60.5}
    counter: Counter
    checksum: {signal: Checksum, kind: sae_j1850}
    reverse: ReverseSwitch
    power_mode: normal
    coast_brake_pct: [[0, 15], [5, 0]]
"""


class PedalDrive(SimulatedDrive):
    """A recorded drive with a pedal node, whose frames come each 20 ms."""

    def __init__(self, folder: Path, segment_s: float = 60.0, config: str = CONFIG) -> None:
        super().__init__(folder, config, segment_s, dbc_path=EXAMPLES / "pedals.dbc")
        self.demanded = None
        self.silent = {"Pedals_Position"}  # of the simulated nodes
        self.feet = pressed(0)
        self._counter, self._next_ns = 0, self.now_ns

    def press(self, throttle_pct: float, brake_pct: float = 0.0, **raws: int) -> "PedalDrive":
        self.feet = pressed(throttle_pct, brake_pct) | raws
        return self

    def pedal(self, at_ns: int, skip: int = 0) -> None:
        self._counter = (self._counter + 1 + skip) % 16
        data = position(self._counter, **self.feet)[:7]
        data += bytes([checksum_of(data, "sae_j1850")])
        self.gateway.receive(Frame(0x0810D021, data, at_ns))

    def tick(self, after_ns: int = 50 * MS) -> None:
        while self._next_ns <= self.now_ns + after_ns:
            self.pedal(self._next_ns)
            self._next_ns += 20 * MS
        super().tick(after_ns)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pedal, brake, both at once, a broken wire for long, a lost frame."""
    one = PedalDrive(tmp_path_factory.mktemp("pedals") / "drive", segment_s=8.0)
    one.begin()
    one.press(60).run(1.5)
    one.press(0).run(0.5)
    one.press(40, 30).run(0.5)
    one.press(40).run(0.2)
    one.press(4).run(0.5)
    one.press(50).run(0.5)
    one.press(50, Throttle1=0).run(0.4)
    one.press(50).run(0.6)
    one.press(0).run(1.2)
    one.pedal(one.now_ns + 1, skip=1)
    one.press(30).run(1.0)
    assert one.gateway.mode is Mode.ACTIVE
    return one.end()


def test_a_drive_with_pedals_is_replayed_to_the_byte_and_its_verdict_holds(drive):
    ran = replay(drive, "--json")
    assert ran.values["replay"]["equal"]
    assert ran.values["replay"]["ticks"] > 180
    assert ran.values["verdict"]["violations"] == []
    assert ran.code == 0


def test_a_replay_from_its_middle_begins_with_what_was_remembered(drive, tmp_path):
    """The last segment begins while a pedal that was not believed has to be released."""
    last = max(int(path.name[:4]) for path in drive.glob("*.core.jsonl.gz"))
    for path in drive.iterdir():
        if not path.name[:4].isdigit() or int(path.name[:4]) == last:
            (tmp_path / path.name).hardlink_to(path)
    found = replay(tmp_path, "--json").values["replay"]
    assert found["equal"]
    assert 10 < found["ticks"] < 100


@pytest.mark.parametrize(
    ("assignment", "field"),
    [
        ("pedals.can.dead_zone_pct=5", "Throttle"),
        ("pedals.can.throttle.pressed=3.5", "Throttle"),
        ("pedals.can.brake.pressed=50", "Brake"),
        ("pedals.can.power_mode=eco", "PowerMode"),
        ("pedals.can.regen_brake=true", "RegenBrake"),
        ("pedals.can.coast_brake_pct=null", "Brake"),
        ("pedals.can.checksum.kind=xor", "Throttle"),
    ],
)
def test_the_pedals_own_numbers_are_tried_on_a_recorded_drive(drive, assignment, field):
    found = what_if(drive, assignment)
    assert field in {one["field"] for one in found["fields"]}
    assert not any("no effect" in note for note in found["notes"])


def test_pedals_that_do_not_fit_the_recorded_dbc_are_refused(drive):
    ran = replay(drive, "--set", "pedals.can.counter=Nothing")
    assert ran.code == 78
    assert 'pedals.can.counter: Pedals_Position has no signal "Nothing"' in ran.err


def test_a_vehicles_own_file_is_tried_without_its_dbc(drive):
    ran = replay(drive, "-c", EXAMPLES / "pedals.yaml")
    assert ran.code in (0, 1), ran.err
    assert "protocol.dbc is not used" in ran.out + ran.err


def test_a_file_is_tried_without_its_dbc_however_it_is_written_and_told_by_its_lines(
    drive, tmp_path
):
    file = tmp_path / "own.yaml"
    file.write_text("protocol: {dbc: nowhere.dbc}\n" + CONFIG)
    ran = replay(drive, "-c", file)
    assert "protocol.dbc is not used" in ran.out, ran.err
    file.write_text("protocol: {dbc: nowhere.dbc}\nlimits:\n  throttle_slew_pct_per_s: no\n")
    ran = replay(drive, "-c", file)
    assert ran.code == 78
    assert f"{file}:3: limits.throttle_slew_pct_per_s" in ran.err


def test_without_its_pedals_the_drive_has_no_demand(drive):
    found = what_if(drive, "pedals.can=null")
    assert found["would_stop"] or not found["same"]


def test_in_a_closed_loop_the_recorded_feet_drive_the_simulated_vehicle(drive):
    ran = replay(drive, "--set", "pedals.can.dead_zone_pct=8", "--closed-loop")
    slow, fast = ran.out.split("highest speed ")[1].split(" km/h")[0].split(" -> ")
    assert slow != fast
    assert min(float(slow), float(fast)) > 1
