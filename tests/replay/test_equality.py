"""A drive replayed with its own configuration: equal to the byte, or the first difference."""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.replay.drives import SimulatedDrive
from tests.replay.ran import changed, replay, rewrite
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.recording import folder
from vcu_gateway.replay.drive_replay import replay_drive


def core(drive: Path, number: int = 1) -> Path:
    return drive / f"{number:04d}.core.jsonl.gz"


def frames(drive: Path, number: int = 1) -> Path:
    return drive / f"{number:04d}.frames.log.gz"


@pytest.mark.parametrize("name", ["ordinary", "every", "limits"])
def test_a_drive_with_every_kind_of_input_is_equal_to_the_byte(recorded, name):
    ran = replay(recorded[name], "--json")
    assert ran.code == 0, ran.out
    found = ran.values["replay"]
    assert found["equal"] is True
    assert found["equal_ticks"] == found["ticks"] > 400
    assert found["answers"] > 0
    assert found["why_sentences"] > 5
    assert found["not_replayed"] == []
    assert ran.values["verdict"]["holds"] is True


def test_every_later_checkpoint_is_compared_with_the_replayed_state(recorded):
    segments = len(list(recorded["every"].glob("*.core.jsonl.gz")))
    assert segments >= 4
    found = replay(recorded["every"], "--json").values["replay"]
    assert found["checkpoints"] == segments - 1


@pytest.mark.parametrize("number", [2, 3, 4])
def test_a_replay_from_any_segment_is_equal_too(every, number):
    for path in every.glob("*.gz"):
        if int(path.name[:4]) < number:
            path.unlink()
    ran = replay(every, "--json")
    assert ran.code == 0, ran.out
    assert ran.values["replay"]["equal_ticks"] == ran.values["replay"]["ticks"] > 50


def test_one_file_of_a_segment_is_replayed_alone(every):
    ran = replay(core(every, 2), "--json")
    assert ran.code == 0
    assert ran.values["replay"]["ticks"] == 100


def test_a_part_is_replayed_from_the_checkpoint_before_it(every):
    found = replay(every, "--from", "11", "--to", "12.0", "--json").values["replay"]
    assert found["ticks"] == 40
    assert found["began"].endswith("11:06:50.050Z")


def test_a_part_is_found_though_somebody_had_set_the_clock_meanwhile(every):
    def an_hour_later(values: dict) -> None:
        values["checkpoint"]["wall"] += 3600 * 10**9

    for number in (3, 4):
        rewrite(core(every, number), changed("checkpoint", an_hour_later))
    found = replay(every, "--from", "11", "--to", "12.0", "--json").values["replay"]
    assert found["ticks"] == 40


def test_a_changed_byte_of_a_recorded_frame_shows_where_it_acts(every):
    def heavier(lines: list[str]) -> list[str]:
        place = next(n for n, line in enumerate(lines) if "1808D0F4#" in line and n > 800)
        head, _, data = lines[place].partition("#")
        payload = bytearray.fromhex(data.split()[0])
        payload[6] |= 0x80  # InternalFault
        lines[place] = f"{head}#{payload.hex().upper()} R"
        return lines

    rewrite(frames(every), heavier)
    ran = replay(every, "--json")
    assert ran.code == 1
    first = ran.values["replay"]["first_difference"]
    assert first["field"] == "PCU1 PowerCut"
    assert (first["recorded"], first["replayed"]) == ("normal", "cut")
    assert first["time"].startswith("2026-11-18T11:06:4")
    assert ran.values["replay"]["equal_ticks"] > 100, "the next checkpoint begins anew"


def test_a_changed_command_shows_the_field_and_both_values(every):
    def more(values: dict) -> None:
        values["frames"][0][2] = "1c" + values["frames"][0][2][2:]

    rewrite(core(every), changed("tick", more, which=30))
    ran = replay(every)
    assert ran.code == 1
    assert "first difference: tick 31 at 11:06:41.550, PCU1 MotorReverse" in ran.out
    assert "  recorded: reverse\n  replayed: forward\n" in ran.out


def test_a_missing_request_shows_as_another_decision(every):
    rewrite(core(every), lambda lines: [one for one in lines if '"arm":' not in one])
    ran = replay(every, "--json")
    assert ran.code == 1
    assert ran.values["replay"]["first_difference"]["field"] in ("mode", "PCU1 PowerMode")
    assert "mode" in ran.values["replay"]["differences"]


def test_a_missing_demand_is_found(every):
    def without(lines: list[str]) -> list[str]:
        offers = [n for n, line in enumerate(lines) if '"offer":' in line]
        return [line for n, line in enumerate(lines) if n not in offers[70:80]]

    rewrite(core(every), without)
    ran = replay(every, "--json")
    assert ran.code == 1
    assert ran.values["replay"]["first_difference"]["tick"] > 60


@pytest.mark.parametrize(
    ("needle", "change", "field"),
    [
        ("why", lambda values: values.update(why="all is well"), "why"),
        ("mode", lambda values: values.update(mode="fault"), "mode"),
        ("events", lambda values: values["events"][0][2].update(detail="none"), "events"),
        ("arm", lambda values: values.update(refused=["not_allowed_now", "no"]), "answer to arm"),
    ],
)
def test_each_kind_of_altered_result_is_told(every, needle, change, field):
    def alter(values: dict) -> None:
        values.pop("granted", None) if needle == "arm" else None
        change(values)

    which = 1 if needle in ("mode", "why") else 0  # the checkpoint has one, too
    rewrite(core(every), changed(needle, alter, which))
    ran = replay(every, "--json")
    assert ran.code == 1
    assert ran.values["replay"]["first_difference"]["field"] == field


def test_a_sentence_of_why_that_is_missing_is_told(every):
    def without(lines: list[str]) -> list[str]:
        places = [n for n, line in enumerate(lines) if '"why":' in line and '"now"' in line]
        return [line for n, line in enumerate(lines) if n != places[4]]

    rewrite(core(every), without)
    first = replay(every, "--json").values["replay"]["first_difference"]
    assert (first["field"], first["recorded"]) == ("why", "nothing")


def test_a_checkpoint_that_is_not_the_replayed_state_is_told_with_its_path(every):
    def alter(values: dict) -> None:
        values["checkpoint"]["state"]["Gateway"]["_modes"]["ModeManager"]["_last_tick_ns"] += 1

    rewrite(core(every, 3), changed("checkpoint", alter))
    first = replay(every, "--json").values["replay"]["first_difference"]
    assert first["field"].startswith("checkpoint Gateway.")
    assert first["field"].endswith("_last_tick_ns")
    assert int(first["recorded"]) == int(first["replayed"]) + 1


def test_a_torn_member_is_told_and_the_next_checkpoint_begins_anew(every):
    path = core(every, 2)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    ran = replay(every, "--json")
    found = ran.values["replay"]
    assert ran.code == 0, "what was compared is equal"
    assert found["not_replayed"], "what was not is told"
    assert found["ticks"] < 455
    assert "not replayed: " in replay(every).out


def test_a_missing_segment_is_told_with_its_ticks(every):
    core(every, 3).unlink()
    frames(every, 3).unlink()
    found = replay(every, "--json").values["replay"]
    assert found["equal"] is True
    (gap,) = found["not_replayed"]
    assert (gap["ticks"], gap["why"]) == (100, "segments 3 to 3 are not there")


def test_what_is_no_recording_is_refused_with_what_to_do(tmp_path):
    ran = replay(tmp_path)
    assert ran.code == 66
    assert "drive.json" in ran.err
    ran = replay(tmp_path / "nothing.log")
    assert ran.code == 66


def test_a_state_of_another_version_is_an_error_that_names_it(every):
    def alter(values: dict) -> None:
        values["checkpoint"]["state"] = {"Gateway": {"news": 1}}

    rewrite(core(every), changed("checkpoint", alter))
    ran = replay(every)
    assert ran.code == 65
    assert "written by vcu-gateway" in ran.err


def test_quiet_says_nothing_and_the_exit_code_tells(every, recorded):
    assert replay(recorded["ordinary"], "--quiet") == (0, "", "")
    rewrite(core(every), changed("mode", lambda values: values.update(mode="fault"), 1))
    assert replay(every, "-q") == (1, "", "")


def test_a_state_made_by_hand_is_refused_with_the_line_that_it_fails_at(every):
    def alter(values: dict) -> None:
        store = values["checkpoint"]["state"]["Gateway"]["_modes"]["ModeManager"]
        store["_last_tick_ns"] = "yesterday"

    rewrite(core(every, 3), changed("checkpoint", alter))
    ran = replay(core(every, 3))
    assert ran.code == 65
    assert re.search(r"0003\.core\.jsonl\.gz:\d+: cannot be decided again \(TypeError", ran.err)
    what_if = ("--set", "limits.derated_power_w=5000")
    assert replay(core(every, 3), *what_if).code == 65
    assert replay(core(every, 3), *what_if, "--closed-loop").code == 65


@pytest.fixture
def ended_by_bug(tmp_path) -> Path:
    """A drive whose core ended the gateway's process in its last tick."""
    drive = SimulatedDrive(tmp_path / "ended").begin()
    drive.run(2.0)
    collector, drive.gateway._collector = drive.gateway._collector, None
    with pytest.raises(AttributeError):
        drive.tick()
    drive.gateway._collector = collector
    return drive.end()


def test_a_bug_that_ended_the_gateway_and_does_not_come_again_is_a_difference(ended_by_bug):
    ran = replay(ended_by_bug, "--json")
    assert ran.code == 1
    first = ran.values["replay"]["first_difference"]
    assert (first["field"], first["replayed"]) == ("tick", "decided")
    assert "the gateway's process ended by a bug in tick" in replay(ended_by_bug).out


def test_a_bug_that_ended_the_gateway_and_comes_again_is_equal(ended_by_bug, monkeypatch):
    tick, ticks = Gateway.tick, replay(ended_by_bug, "--json").values["replay"]["ticks"]
    done = 0

    def fails_at_last(gateway, now_ns):
        nonlocal done
        done += 1
        if done == ticks:
            raise ValueError("not in tuple")
        return tick(gateway, now_ns)

    monkeypatch.setattr(Gateway, "tick", fails_at_last)
    ran = replay(ended_by_bug, "--json")
    assert ran.code == 0, ran.out
    assert ran.values["replay"]["ended_by_bug"]["error"] == "ValueError: not in tuple"


@pytest.mark.parametrize("more", [(), ("--closed-loop",)])
def test_what_another_configuration_had_done_until_a_bug_is_told(ended_by_bug, more):
    ran = replay(ended_by_bug, "--set", "limits.derated_power_w=5000", "--json", *more)
    assert ran.code in (0, 1), ran.err


def test_a_drive_of_which_nothing_can_be_replayed_is_no_success(every):
    for number in (1, 2, 3, 4, 5):
        if core(every, number).exists():
            core(every, number).write_bytes(b"")
    what_if = ("--set", "limits.derated_power_w=5000")
    for more in ((), what_if, (*what_if, "--closed-loop")):
        ran = replay(every, *more)
        assert ran.code == 65
        assert "has no tick that can be replayed" in ran.err


def test_a_time_of_which_there_is_nothing_is_refused(every):
    ran = replay(every, "--from", "3600")
    assert ran.code == 65
    assert "has nothing of that time" in ran.err
    assert replay(every, "--from", "2020-01-01T00:00", "--to", "2020-01-02T00:00").code == 65


def test_a_recording_is_found_by_its_name(every, monkeypatch, tmp_path):
    monkeypatch.setattr(folder, "DEFAULT_FOLDER", tmp_path)
    monkeypatch.chdir("/")
    assert replay("every", "-q").code == 66
    (tmp_path / "drives").mkdir()
    every.rename(tmp_path / "drives" / "every")
    assert replay("every", "-q").code == 0


@pytest.mark.skipif(os.geteuid() != 0, reason="another user's rights need root")
def test_who_may_not_look_is_told_which_group_to_join():
    with tempfile.TemporaryDirectory() as name:
        code = (
            "import os; from pathlib import Path; from vcu_gateway.recording import folder;"
            "os.setgroups([]); os.setresgid(65534, 65534, 65534);"
            "os.setresuid(65534, 65534, 65534);"
            f" folder.DEFAULT_FOLDER = Path({name!r});"
            f" folder.recording_path('20261123T180412Z-1f3a9c2e')"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], cwd="/", capture_output=True, text=True, check=False
        )
    assert "NotPermittedError" in done.stderr
    assert "usermod -aG vcu-gateway-recorder" in done.stderr


def test_a_program_replays_a_drive_without_the_command_line(recorded, tmp_path):
    report = replay_drive(recorded["ordinary"])
    said = replay(recorded["ordinary"], "--json").values
    assert json.loads(json.dumps(report.values)) == said
    report.write_html(tmp_path / "replay.html")
    assert "to the byte" in (tmp_path / "replay.html").read_text()
