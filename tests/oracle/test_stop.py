"""What is known of a stop: the gateway's words beside the bus and the controllers' own."""

import json
import os
import subprocess
import sys
import time

import pytest

from tests.oracle import wire
from tests.oracle.bench import Bench
from tests.oracle.stages import (
    CONTROLLERS,
    CUT,
    GAP_S,
    LATCHED,
    NEXT_TICK_S,
    NOT_OBEYED,
    ON_BUS,
    SENT,
    SETTLE_S,
    STAMPS_AGREE_S,
    STATUS1,
    UNKNOWN_S,
    Told,
    first_cuts,
    full_queue,
    ignores,
    link_down,
    obeys,
    press,
    report,
    stages,
    told,
    until_stage,
    watched,
)

BOTH = tuple(CONTROLLERS)
IN_ORDER = [None, LATCHED, SENT, ON_BUS, CUT]
BATTERY = "BMS_Status"


def cut(bench: Bench) -> float:
    """A stop that both controllers obey; when it was pressed."""
    pressed = press(bench)
    until_stage(bench, CUT)
    return pressed


def silent_and_on_the_bus(bench: Bench) -> dict[str, float]:
    """A stop on the bus while no Status1 comes by itself; the first POWER_CUT of each."""
    bench.vehicle.silence(*STATUS1)
    return first_cuts(bench, press(bench))


# --- obeyed --------------------------------------------------------------------------------------


def test_nothing_is_said_where_no_cut_is_latched(bench):
    assert told(bench).stop is None
    bench.drive(throttle_pct=20)
    assert told(bench).stop is None
    bench.vehicle.set("PCU2_Status1", TemperatureProtectLevel=2)
    bench.rest(0.15)
    assert bench.mode() == "fault"
    assert told(bench).stop is None, "a STOP cuts nothing"


def test_a_stop_is_sent_then_on_the_bus_then_cut_at_the_buss_own_times(bench, figures):
    bench.drive(throttle_pct=20)
    pressed = press(bench)
    seen = watched(bench, 1.2)
    begun = first_cuts(bench, pressed)
    steps = stages(seen)
    assert steps == sorted(steps, key=IN_ORDER.index), steps
    assert steps[-2:] == [ON_BUS, CUT]
    for pcu in CONTROLLERS:
        times_are_the_buss(bench, pcu, seen, begun[pcu])
    took = next(one.t for one in seen if one.stage == CUT) - pressed
    on_bus = max(begun.values()) - pressed
    figures.append(
        f"a stop: POWER_CUT on the bus after {on_bus * 1000:.0f} ms, confirmed after "
        f"{took * 1000:.0f} ms: {' > '.join(map(str, steps))}"
    )


def times_are_the_buss(bench: Bench, pcu: str, seen: list[Told], begun: float) -> None:
    words = [f.t for f in bench.recorder.of(f"{pcu}_Status1", begun + SETTLE_S)]
    for one in (one for one in seen if one.stop):
        sent, echoed, judged = (one.at(pcu, age) for age in ("sent_ms", "echoed_ms", "judged_ms"))
        assert sent is None or abs(sent - begun) < 0.010
        assert echoed is None or abs(echoed - begun) < STAMPS_AGREE_S
        assert (judged is None) == (one.of(pcu)["obeyed"] is None)
        assert judged is None or any(abs(judged - word) < STAMPS_AGREE_S for word in words)
        assert one.stage != CUT or one.of(pcu)["obeyed"] is True
    first = next(one for one in seen if one.stop and one.of(pcu)["obeyed"])
    assert first.t > words[0]
    assert abs(first.at(pcu, "judged_ms") - words[0]) < STAMPS_AGREE_S
    assert seen[-1].of(pcu)["power_cut"] == "cut"
    assert seen[-1].of(pcu)["throttle_pct"] == 0
    assert seen[-1].of(pcu)["missing"] == ""


def test_the_sentence_says_no_more_than_the_stage(bench):
    bench.drive(throttle_pct=20)
    press(bench)
    waiting = "Stop on the bus; waiting for PCU1 and PCU2 to confirm"
    assert waiting in [one.sentence for one in until_stage(bench, CUT)]
    assert told(bench).sentence == "Power is cut: PCU1 and PCU2 confirm"


def test_the_last_of_what_was_sent_and_came_back_is_told_beside_what_was_decided(bench):
    cut(bench)
    for pcu, can_id in CONTROLLERS.items():
        state = told(bench)
        command = state.commands[pcu]
        wanted = f"{can_id:08X}#{wire.POWER_CUT.hex()}".upper()
        assert command["decided"].upper() == wanted
        frames = [f.t for f in bench.commands(state.t - 0.2) if f.can_id == can_id]
        for what in ("sent", "echoed"):
            assert command[what]["frame"].upper() == wanted
            at = state.t - command[what]["age_ms"] / 1000
            assert any(abs(at - frame) < 0.010 for frame in frames), what


@pytest.mark.parametrize("says", [obeys, ignores], ids=["cut", "normal"])
def test_a_status1_within_100_ms_of_the_echo_says_nothing_and_the_next_one_does(bench, says):
    bench.drive(throttle_pct=20)
    begun = silent_and_on_the_bus(bench)
    says(bench, *BOTH)
    early = report(bench, *BOTH, at=min(begun.values()) + 0.070)
    assert early < min(begun.values()) + SETTLE_S, "the vehicle was late"
    unconfirmed(watched(bench, 0.3))
    assert all(told(bench).of(pcu)["obeyed"] is None for pcu in BOTH)
    report(bench, *BOTH)
    until_stage(bench, CUT if says is obeys else NOT_OBEYED, 0.5)


def unconfirmed(seen: list[Told]) -> None:
    """On the bus, which the tick after its echo tells, and no more at any time."""
    assert stages(seen) in ([SENT, ON_BUS], [ON_BUS])


# --- not obeyed ----------------------------------------------------------------------------------


@pytest.mark.parametrize("deaf", [("PCU1",), ("PCU2",), BOTH], ids="+".join)
def test_a_controller_that_ignores_the_stop_is_told_and_never_counts_as_cut(bench, deaf):
    bench.drive(throttle_pct=20)
    ignores(bench, *deaf)
    press(bench)
    seen = watched(bench, 1.8)
    assert CUT not in stages(seen)
    assert stages(seen)[-2:] == [ON_BUS, NOT_OBEYED]
    assert seen[-1].sentence.startswith("NOT OBEYED: ")
    assert seen[-1].sentence.endswith("; use the contactor")
    for pcu in BOTH:
        says = f"{pcu} reports PowerCut normal, throttle 19.9 %"
        assert (says in seen[-1].sentence) == (pcu in deaf), seen[-1].sentence
        assert seen[-1].of(pcu)["obeyed"] is (pcu not in deaf)
        assert bool(seen[-1].of(pcu)["missing"]) == (pcu in deaf)
    assert (seen[-1].of(deaf[0])["power_cut"], seen[-1].of(deaf[0])["throttle_pct"]) == (
        "normal",
        pytest.approx(19.89, abs=0.02),
    )


def test_a_controller_that_changes_its_mind_is_believed_each_time(bench):
    cut(bench)
    ignores(bench, "PCU2")
    until_stage(bench, NOT_OBEYED, 0.8)
    assert told(bench).of("PCU1")["obeyed"] is True
    obeys(bench, "PCU2")
    assert stages(until_stage(bench, CUT, 0.8)) == [NOT_OBEYED, CUT]


@pytest.mark.parametrize(("raw", "stage"), [(12, CUT), (13, NOT_OBEYED)])
def test_a_controller_that_has_cut_and_reports_throttle_obeys_below_5_percent(bench, raw, stage):
    bench.vehicle.echo("PCU1", cut=1, throttle=raw)
    press(bench)
    seen = until_stage(bench, stage)
    assert (CUT in stages(seen)) == (stage == CUT)
    if stage == NOT_OBEYED:
        assert "PCU1 reports PowerCut cut, throttle 5.1 %" in seen[-1].sentence


def test_one_that_drives_on_without_throttle_does_not_obey(bench):
    bench.vehicle.echo("PCU1", cut=0, throttle=0)
    press(bench)
    seen = until_stage(bench, NOT_OBEYED)
    assert "PCU1 reports PowerCut normal, throttle 0.0 %" in seen[-1].sentence


# --- unknown -------------------------------------------------------------------------------------


def test_a_controller_that_says_nothing_is_missing_after_1600_ms_and_never_cut(bench):
    pressed = time.monotonic()
    bench.vehicle.silence("PCU1_Status1")
    press(bench)
    seen = watched(bench, 2.4)
    begun = first_cuts(bench, pressed)["PCU1"]
    assert stages(seen)[-1] == ON_BUS
    assert CUT not in stages(seen)
    late = begun + UNKNOWN_S
    before = [one for one in seen if begun + 0.8 < one.t < late - STAMPS_AGREE_S]
    after = [one for one in seen if one.t > late + NEXT_TICK_S]
    assert {one.sentence for one in before} == {"Stop on the bus; waiting for PCU1 to confirm"}
    assert {one.sentence for one in after} == {"Stop sent; PCU1 does not confirm"}
    assert seen[-1].of("PCU1")["obeyed"] is None
    assert seen[-1].of("PCU1")["missing"]
    assert seen[-1].of("PCU2")["missing"] == ""


def test_a_word_older_than_1600_ms_counts_no_more(bench):
    cut(bench)
    bench.vehicle.silence("PCU2_Status1")
    seen = watched(bench, 2.4)
    last = bench.recorder.of("PCU2_Status1")[-1].t
    assert {one.stage for one in seen if one.t < last + UNKNOWN_S - STAMPS_AGREE_S} == {CUT}
    assert {one.stage for one in seen if one.t > last + UNKNOWN_S + NEXT_TICK_S} == {ON_BUS}
    assert seen[-1].of("PCU2")["obeyed"] is None
    bench.vehicle.resume("PCU2_Status1")
    until_stage(bench, CUT, 0.5)


# --- not on the bus ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("trouble", "cut_within_s"), [(full_queue, 3.0), (link_down, 5.0)], ids=["full", "down"]
)
def test_where_the_kernel_takes_no_frame_nothing_is_said_to_be_sent(bench, trouble, cut_within_s):
    bench.drive(throttle_pct=20)
    with trouble(bench):
        pressed = press(bench)
        seen = watched(bench, 1.0)
        assert bench.commands(pressed) == []
        nothing_left(seen)
    until_stage(bench, CUT, cut_within_s)


def nothing_left(seen: list[Told]) -> None:
    assert stages(seen[3:]) == [LATCHED]
    assert seen[-1].sentence == "Stop latched; not sent to PCU1 and PCU2"
    for pcu in BOTH:
        assert [seen[-1].of(pcu)[age] for age in ("sent_ms", "echoed_ms", "judged_ms")] == [
            None
        ] * 3
        command = seen[-1].commands[pcu]
        assert command["decided"].upper().endswith(wire.POWER_CUT.hex().upper())
        for what in ("sent", "echoed"):
            last = command[what]
            assert not last["frame"].upper().endswith(wire.POWER_CUT.hex().upper())
            assert last["age_ms"] > 800


def test_where_the_link_is_lost_after_the_cut_it_is_cut_no_more(bench):
    pressed = cut(bench)
    with link_down(bench):
        seen = watched(bench, 0.6)
        last = max(f.t for f in bench.commands(pressed))
        assert {one.stage for one in seen if one.t > last + GAP_S + NEXT_TICK_S} == {LATCHED}
        for pcu in BOTH:
            assert seen[-1].of(pcu)["sent_ms"] is None
            assert seen[-1].of(pcu)["echoed_ms"] is None
    up = time.monotonic()
    until_stage(bench, CUT, 5.0)
    begun = first_cuts(bench, up - 0.2)
    again = told(bench)
    for pcu in BOTH:
        assert abs(again.at(pcu, "echoed_ms") - begun[pcu]) < STAMPS_AGREE_S, "without a gap"


# --- its beginning and its end -------------------------------------------------------------------


def test_a_reset_ends_it_and_a_second_stop_begins_with_nothing_known(bench):
    cut(bench)
    bench.rest(1.1)
    bench.service_reset()
    bench.wait(lambda: told(bench).stop is None, "no stop", 0.3)
    bench.standby()
    begun = silent_and_on_the_bus(bench)
    seen = watched(bench, 0.5)
    unconfirmed(seen)
    for pcu in BOTH:
        one = seen[-1].of(pcu)
        assert (one["obeyed"], one["judged_ms"], one["power_cut"], one["throttle_pct"]) == (
            None,
        ) * 4
        assert abs(seen[-1].at(pcu, "echoed_ms") - begun[pcu]) < STAMPS_AGREE_S


def test_a_reset_that_is_refused_ends_nothing(bench):
    cut(bench)
    assert bench.client.refusal("reset"), "driver level"
    bench.rest(0.1)
    assert told(bench).stage == CUT


def test_a_cut_of_the_battery_is_a_stop_like_any_other(bench):
    bench.drive(throttle_pct=20)
    since = time.monotonic()
    bench.vehicle.set(BATTERY, InternalFault=1)
    arrived = bench.frame(BATTERY, since).t
    seen = until_stage(bench, CUT)
    assert "InternalFault" in seen[-1].stop["reason"]
    latched = seen[-1].t - seen[-1].stop["latched_ms"] / 1000
    assert -STAMPS_AGREE_S < latched - arrived < NEXT_TICK_S


def test_a_second_press_changes_nothing(bench):
    cut(bench)
    before = told(bench)
    press(bench)
    seen = watched(bench, 0.3)
    assert stages(seen) == [CUT]
    began = before.t - before.stop["latched_ms"] / 1000
    assert abs(seen[-1].t - seen[-1].stop["latched_ms"] / 1000 - began) < STAMPS_AGREE_S


def test_a_stop_that_survived_the_process_is_judged_from_the_new_ones_frames(own_bench):
    bench = own_bench
    bench.run(fresh=True)
    bench.standby()
    cut(bench)
    bench.let_go()
    bench.gateway.kill()
    killed = time.monotonic()
    bench.hang_up()
    bench.launch()
    bench.connect()
    assert told(bench).stage == LATCHED, "it listens before it talks"
    seen = until_stage(bench, CUT, 5.0)
    begun = first_cuts(bench, killed)
    for pcu in BOTH:
        assert abs(seen[-1].at(pcu, "echoed_ms") - begun[pcu]) < STAMPS_AGREE_S
        assert seen[-1].at(pcu, "judged_ms") > begun[pcu] + SETTLE_S - STAMPS_AGREE_S


def stop_stages(bench: Bench) -> list[dict]:
    """The events of that name, the newest last."""
    events = bench.client.call("events", limit=200)["events"]
    found = [one for one in events if one["name"] == "stop_stage"]
    return sorted(found, key=lambda one: -one["last_ms"])


def of_stage(events: list[dict], stage: str) -> int:
    """How often it was told."""
    return sum(one["count"] for one in events if one["fields"]["stage"] == stage)


def test_each_change_of_the_stage_is_one_event(bench):
    ignores(bench, "PCU1")
    before = stop_stages(bench)
    press(bench)
    until_stage(bench, NOT_OBEYED)
    obeys(bench, "PCU1")
    until_stage(bench, CUT)
    after = stop_stages(bench)
    assert [one["fields"]["stage"] for one in after][-2:] == [NOT_OBEYED, CUT]
    assert [one["severity"] for one in after][-2:] == ["critical", "info"]
    for stage in (NOT_OBEYED, CUT):
        assert of_stage(after, stage) == of_stage(before, stage) + 1


# --- the verb ------------------------------------------------------------------------------------


def verb(bench: Bench, *options: str) -> subprocess.Popen:
    socket = str(bench.gateway.folder / "control.sock")
    return subprocess.Popen(
        [sys.executable, "-m", "vcu_gateway", "estop", "--socket", socket, *options],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=dict(os.environ),
    )  # fmt: skip


def ended(bench: Bench, process: subprocess.Popen) -> tuple[int, str]:
    bench.wait(lambda: process.poll() is not None, "the verb's end", 15.0)
    return process.returncode, process.communicate()[0]


def test_the_verb_ends_well_only_where_both_controllers_say_that_they_have_cut(bench):
    status, text = ended(bench, verb(bench))
    assert (status, text.splitlines()[-1]) == (0, "Power is cut: PCU1 and PCU2 confirm")


def test_the_verb_says_who_does_not_obey(bench):
    ignores(bench, "PCU1")
    status, text = ended(bench, verb(bench))
    assert status
    assert "NOT OBEYED: PCU1 reports PowerCut normal, throttle 19.9 %; use the contactor" in text


def test_the_verb_says_who_does_not_confirm(bench):
    bench.vehicle.silence("PCU2_Status1")
    status, text = ended(bench, verb(bench))
    assert status
    assert "Stop sent; PCU2 does not confirm" in text


def test_the_verb_says_that_nothing_was_sent(bench):
    with full_queue(bench):
        status, text = ended(bench, verb(bench))
    assert status
    assert "not sent to PCU1 and PCU2" in text
    assert "Power is cut" not in text


def test_the_verb_gives_the_same_as_json(bench):
    status, text = ended(bench, verb(bench, "--json"))
    last = json.loads(text.splitlines()[-1])
    assert status == 0
    assert last["stop"]["stage"] == CUT


# --- times ---------------------------------------------------------------------------------------

PRESSES = 100
PRESS_TO_BUS_S = 0.150


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_from_the_press_to_power_cut_on_the_bus(bench, figures):
    """By the kernel's stamp of the second controller's frame; at phases spread over a tick."""
    took: list[float] = []
    disturbed = 0
    while len(took) < PRESSES and disturbed < PRESSES:
        bench.standby()
        bench.rest(0.003 * ((len(took) + disturbed) % 17))
        pressed = press(bench)
        reached = max(first_cuts(bench, pressed).values())
        if bench.disturbed(pressed):
            disturbed += 1
        else:
            took.append(reached - pressed)
    figures.append(f"press to POWER_CUT for both: {quantiles_ms(took)}; disturbed: {disturbed}")
    assert len(took) == PRESSES, "the machine was too busy"
    assert sorted(took)[-2] <= PRESS_TO_BUS_S


def quantiles_ms(took_s: list[float]) -> str:
    took = sorted(one * 1000 for one in took_s)
    p50, p99 = took[len(took) // 2], took[int(len(took) * 0.99) - 1]
    return f"{len(took)} presses, p50 {p50:.1f} ms, p99 {p99:.1f} ms, longest {took[-1]:.1f} ms"
