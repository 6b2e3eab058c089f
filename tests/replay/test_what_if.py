"""What another configuration would have done, for every key of the core's settings."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.replay.drives import SimulatedDrive, tuned
from tests.replay.ran import replay, what_if
from vcu_gateway.core import calls
from vcu_gateway.core.demand import ControllerDemand, Demand
from vcu_gateway.core.settings import KEYS


def fields(found: dict[str, Any]) -> set[str]:
    return {one["field"] for one in found["fields"]}


def causes(found: dict[str, Any]) -> set[tuple[str, str]]:
    spans = [(one["change"], one["after"] or one["before"]) for one in found["causes"]]
    return {(change, span["cause"]) for change, span in spans}


def requests(found: dict[str, Any]) -> set[str]:
    return set(found["requests_by_kind"])


# Of each key: another value, where its difference shows, and what of it.
EXPECTED: dict[str, tuple[str, Any]] = {
    "freshness.stale_after_ms.BMS_Temperatures=300": (
        "limits",
        lambda found: ("appears", "stale") in causes(found),
    ),
    "freshness.late_after_ms.BMS_Status=1600": (
        "limits",
        lambda found: ("vanishes", "late") in causes(found),
    ),
    "freshness.late_after_ms.BMS_Status=400": (
        "limits",
        lambda found: ("moves", "late") in causes(found),
    ),
    "protocol.transmit_priority=3": ("limits", lambda found: fields(found) == {"identifier"}),
    "limits.speed_limit_max_rpm=2000": ("limits", lambda found: "SpeedLimit" in fields(found)),
    "limits.power_limit_max_w=5000": ("limits", lambda found: fields(found) == {"PowerLimit"}),
    "limits.derated_power_w=2000": ("limits", lambda found: fields(found) == {"PowerLimit"}),
    "limits.regen_limit_pct=5": ("limits", lambda found: fields(found) == {"Brake"}),
    "limits.throttle_slew_pct_per_s=50": ("limits", lambda found: fields(found) == {"Throttle"}),
    "limits.power_slew_w_per_s=20000": ("limits", lambda found: fields(found) == {"PowerLimit"}),
    "limits.regen_slew_pct_per_s=20": ("limits", lambda found: fields(found) == {"Brake"}),
    "limits.speed_slew_rpm_per_s=1000": ("limits", lambda found: "SpeedLimit" in fields(found)),
    "limits.power_return_w_per_s=60000": ("tuned", lambda found: fields(found) == {"PowerLimit"}),
    "limits.brake_return_pct_per_s=100": ("tuned", lambda found: fields(found) == {"Brake"}),
    "limits.speed_fall_rpm_per_s=4000": ("tuned", lambda found: fields(found) == {"SpeedLimit"}),
    "limits.speed_return_rpm_per_s=20000": (
        "tuned",
        lambda found: fields(found) == {"SpeedLimit"},
    ),
    "limits.direction_change_rpm=0": ("limits", lambda found: "MotorReverse" in fields(found)),
    "limits.regen_min_rpm=1000": ("limits", lambda found: "RegenBrake" in fields(found)),
    "safety.required_messages=[BMS_Status, PCU1_Status2, PCU2_Status2, IMU_Attitude]": (
        "limits",
        lambda found: found["would_stop"][0]["why"].startswith("fault; latched (driver): IMU_At"),
    ),
    "safety.listen_before_talk_ms=2000": ("limits", lambda found: "frame" in fields(found)),
    "safety.qualify_frames=100": (
        "limits",
        lambda found: "arm" in requests(found) and found["before"]["mode_s"]["active"] > 20,
    ),
    "safety.clear_hold_ms=4000": (
        "limits",
        lambda found: any(change == "moves" for change, _ in causes(found)),
    ),
    "safety.echo_below_max_pct=5": ("disobeys", lambda found: found["would_stop"]),
    "safety.motor_speed_step_max_rpm=500": (
        "jumps",
        lambda found: ("appears", "speed_step") in causes(found),
    ),
    "safety.wheel_speed_step_max_kmh=5": (
        "jumps",
        lambda found: ("appears", "wheel_speed_step") in causes(found),
    ),
    "safety.wheel_speed_difference_max_kmh=1": (
        "jumps",
        lambda found: ("appears", "wheel_speed_difference") in causes(found),
    ),
    "demand.ttl_max_ms=100": ("limits", lambda found: "demand" in requests(found)),
    "demand.ttl_default_ms=100": ("limits", lambda found: found["same"]),
    "demand.priorities={remote: 5}": ("limits", lambda found: "demand" in requests(found)),
    "demand.independent_directions=true": ("directions", lambda found: not found["same"]),
    "demand.second_track_required=true": (
        "limits",
        lambda found: found["requests_by_kind"]["demand"] > 500,
    ),
    "bench.auto_arm=true": ("limits", lambda found: found["same"]),
}


def jumps(folder: Path) -> Path:
    """A drive on which a motor's and a wheel's speed jump, within the default limits."""
    drive = SimulatedDrive(folder).begin()
    drive.throttle(20.0)
    drive.run(2.0)

    def jump(name: str, data: bytes) -> bytes:
        if name == "PCU1_Status2":
            speed_rpm = int.from_bytes(data[6:8], "little") + 900
            return data[:6] + speed_rpm.to_bytes(2, "little")
        if name == "ARD2_SteeringWheel":
            speed_raw = int.from_bytes(data[2:4], "little") + 8_000
            return data[:2] + speed_raw.to_bytes(2, "little") + data[4:]
        return data

    drive.change = jump
    drive.run(2.0)
    return drive.end()


def disobeys(folder: Path) -> Path:
    """A drive on which one controller gives 10 % less throttle than commanded."""
    drive = SimulatedDrive(folder).begin()
    drive.throttle(40.0)
    drive.run(3.0)
    drive.change = lambda name, data: (
        data[:1] + bytes([data[1] - 26]) + data[2:] if name == "PCU1_Status1" else data
    )
    drive.run(3.0)
    return drive.end()


def directions(folder: Path) -> Path:
    """A drive on which somebody asks for two directions."""
    drive = SimulatedDrive(folder).begin()
    for number in range(20):
        both = {"PCU1": ControllerDemand(), "PCU2": ControllerDemand(motor_reverse=True)}
        drive.gateway.apply(calls.Offer(Demand("driver", 1000 + number, 200, both), drive.now_ns))
        drive.demanded = None
        drive.tick()
    return drive.end()


@pytest.fixture(scope="session")
def drives(recorded: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("special")
    made = {"jumps": jumps, "disobeys": disobeys, "directions": directions, "tuned": tuned}
    return recorded | {name: make(folder / name) for name, make in made.items()}


@pytest.mark.ci
@pytest.mark.parametrize("assignment", EXPECTED)
def test_each_key_shows_what_it_changes(drives, assignment):
    name, expected = EXPECTED[assignment]
    found = what_if(drives[name], assignment)
    assert expected(found), json.dumps(found)[:3000]


def test_every_key_of_the_settings_is_tried():
    tried = {".".join(one.partition("=")[0].split(".")[:2]) for one in EXPECTED}
    assert tried == {f"{key.section}.{name}" for name, key in KEYS.items()}


def test_the_recorded_configuration_as_a_what_if_changes_nothing(recorded):
    for drive in recorded.values():
        ran = replay(drive, "-c", drive / "config.yaml", "--json")
        found = ran.values["what_if"]
        assert found["causes"] == []
        assert found["requests"] == [] or drive.name == "every"


def test_a_smaller_slew_gives_less_throttle_for_so_many_ticks(recorded):
    found = what_if(recorded["ordinary"], "limits.throttle_slew_pct_per_s=50")
    first, second = found["fields"]
    assert {first["controller"], second["controller"]} == {"PCU1", "PCU2"}
    assert first["ticks"] == second["ticks"] == found["different_ticks"] > 30
    largest = first["largest"]
    assert float(largest["before"].split()[0]) > float(largest["after"].split()[0])
    assert largest["difference"] > 25
    assert found["first_different_command"] == first["first"]["time"]
    assert found["would_stop"] == [], "the recorded echoes are held against the recorded commands"


def test_the_table_says_it_in_words(recorded):
    ran = replay(recorded["ordinary"], "--set", "limits.throttle_slew_pct_per_s=50")
    assert ran.code == 1
    assert "what if: limits.throttle_slew_pct_per_s=50\n" in ran.out
    assert "open loop: the recorded vehicle does not react. From 11:06:43.100 on" in ran.out
    assert "\nPCU1, PCU2  Throttle" in ran.out
    assert " % -> " in ran.out
    assert "in active    20.0 s  20.0 s" in ran.out


def test_a_stop_that_would_have_been_is_told_in_the_words_of_why(recorded):
    messages = "BMS_Status, PCU1_Status2, PCU2_Status2, IMU_Attitude"
    ran = replay(recorded["limits"], "--set", f"safety.required_messages=[{messages}]")
    assert "would have stopped at 11:07:0" in ran.out
    assert ": fault; latched (driver): IMU_Attitude" in ran.out
    assert "seconds" not in ran.err


def test_a_recorded_reload_is_left_out_and_told(recorded):
    ran = replay(recorded["every"], "--set", "limits.derated_power_w=9000")
    assert "1 recorded reload left out, the first at 11:06:50" in ran.out
    assert "the given configuration holds for the whole drive" in ran.out


def test_after_a_gap_a_what_if_begins_with_the_recorded_state(every):
    for path in every.glob("0003.*"):
        path.unlink()
    ran = replay(every, "--set", "limits.throttle_slew_pct_per_s=50")
    assert "not replayed: 100 ticks" in ran.out
    assert "from there on it begins with the recorded state" in ran.out


def test_another_file_is_a_what_if_and_single_keys_change_it(recorded, tmp_path):
    other = tmp_path / "other.yaml"
    other.write_text("limits:\n  throttle_slew_pct_per_s: 50\n  power_limit_max_w: 5000\n")
    found = replay(recorded["ordinary"], "-c", other, "--json").values["what_if"]
    assert fields(found) == {"Throttle", "PowerLimit"}
    more = ("--set", "limits.throttle_slew_pct_per_s=100")
    found = replay(recorded["ordinary"], "-c", other, *more, "--json").values["what_if"]
    assert fields(found) == {"PowerLimit"}


@pytest.mark.parametrize(
    ("assignment", "told"),
    [
        ("limits.throtle_slew_pct_per_s=50", 'did you mean "throttle_slew_pct_per_s"?'),
        ("limit.throttle_slew_pct_per_s=50", 'did you mean "limits"?'),
        ("limits.throttle_slew_pct_per_s=500", "must be at most 200 %/s, not 500"),
        ("limits.throttle_slew_pct_per_s=fast", 'must be a number in %/s, not "fast"'),
        ("limits.throttle_slew_pct_per_s", "write section.key=value"),
        ("throttle_slew_pct_per_s=50", 'did you mean "limits.throttle_slew_pct_per_s=50"?'),
        ("demand.priorities={a: 3", "is not valid YAML"),
        ("freshness.stale_after_ms.BMS_Status=9000", "at most 3200 ms"),
    ],
)
def test_a_wrong_key_or_value_is_refused_with_what_to_do(recorded, assignment, told):
    ran = replay(recorded["ordinary"], "--set", assignment)
    assert ran.code == 78
    assert ran.err.startswith("error: --set: ")
    assert told in ran.err


def test_a_wrong_file_is_refused_with_its_line(recorded, tmp_path):
    other = tmp_path / "other.yaml"
    other.write_text("limits:\n  throttle_slew_pct_per_s: 500\n")
    ran = replay(recorded["ordinary"], "-c", other)
    assert ran.code == 78
    assert f"{other}:2: limits.throttle_slew_pct_per_s" in ran.err


def test_a_key_without_effect_on_decisions_is_told(recorded):
    ran = replay(recorded["ordinary"], "--set", "log.level=debug")
    assert ran.code == 0
    assert "log.level has no effect on what is decided" in ran.out
    assert "nothing differs in 461 ticks" in ran.out


def test_a_bench_demand_holds_from_the_start_of_a_recording(recorded):
    bench = ("bench.demand.bench_use_only=true", "bench.demand.throttle_pct=10")
    found = what_if(recorded["every"], *bench)
    assert not found["same"]


def test_the_closed_loop_lets_a_simulated_vehicle_react(recorded):
    sets = ("--set", "limits.throttle_slew_pct_per_s=20")
    ran = replay(recorded["ordinary"], *sets, "--closed-loop", "--json")
    found = ran.values["what_if"]
    assert ran.code == 1
    assert found["loop"] == "closed loop"
    assert fields(found) == {"Throttle"}
    speeds = next(note for note in found["notes"] if note.startswith("highest speed"))
    before, after = (float(part.split()[-1]) for part in speeds.split(" km/h")[0].split("->"))
    assert before > after > 10
    again = replay(recorded["ordinary"], *sets, "--closed-loop", "--json")
    assert again.out == ran.out, "simulated time is the same every time"


def test_a_closed_loop_without_another_configuration_changes_nothing(recorded):
    ran = replay(recorded["ordinary"], "--closed-loop")
    assert ran.code == 0
    assert "nothing differs" in ran.out


def test_the_html_report_has_the_what_if_over_the_drive(recorded, tmp_path):
    page = tmp_path / "what-if.html"
    ran = replay(
        recorded["ordinary"], "--set", "limits.throttle_slew_pct_per_s=50", "--html", page, "-q"
    )
    assert ran == (1, "", "")
    text = page.read_text(encoding="utf-8")
    assert "open loop: the recorded vehicle does not react" in text
    assert "limits.throttle_slew_pct_per_s=50" in text
    assert text.count('"whatIf":true') == 1, "the modes, and no cause that is the recording's"
    assert len(text) < 2_000_000
