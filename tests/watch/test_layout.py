"""The layout: everything important in 80 x 24, more where there is room."""

import copy
import dataclasses
import re

import pytest
from rich.text import Text

from tests.watch import view_models
from vcu_gateway.watch.figures import cell, controller_lines, panel_lines, short_lines, wrapped
from vcu_gateway.watch.layout import mode_lines, reason_lines, title_line, upper_lines
from vcu_gateway.watch.signals import plain, signal_lines
from vcu_gateway.watch.source import ViewModel

VIEWS = [
    view_models.driving,
    view_models.tuned,
    view_models.starting,
    view_models.faulty,
    view_models.unreachable,
    ViewModel,
]
KINDS = ("Status1", "Status2")
SIZES = [(80, 24), (120, 40), (100, 30), (160, 50), (40, 10)]


def page(view: ViewModel, width: int = 80, height: int = 24) -> str:
    return text_of(upper_lines("vcu-gateway", view, width, height))


def text_of(lines: list[Text]) -> str:
    return "\n".join(line.plain.rstrip() for line in lines) + "\n"


def signals(view: ViewModel, width: int = 80, wanted: str = "", old: bool = False) -> str:
    return text_of(signal_lines(view.state, width, wanted, old))


def styles(lines: list[Text], words: str) -> str:
    """The styles of the line with these words."""
    line = next(line for line in lines if words in line.plain)
    return " ".join([str(line.style), *(str(span.style) for span in line.spans)])


@pytest.mark.parametrize("make_view", VIEWS)
@pytest.mark.parametrize(("width", "height"), SIZES[:4])
def test_nothing_is_wider_than_the_terminal(make_view, width, height):
    view = make_view()
    lines = upper_lines("vcu-gateway", view, width, height)
    lines += signal_lines(view.state, width)
    assert max(line.cell_len for line in lines) <= width


@pytest.mark.parametrize("make_view", VIEWS)
def test_in_80_by_24_four_lines_are_left_for_signals_and_keys(make_view):
    assert len(upper_lines("vcu-gateway", make_view(), 80, 24)) <= 20


@pytest.mark.parametrize("make_view", VIEWS)
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_every_view_can_be_shown_in_every_size(make_view, width, height):
    view = make_view()
    assert upper_lines("vcu-gateway", view, width, height)
    assert signal_lines(view.state, width)
    assert plain("vcu-gateway", view).endswith("\n")


def test_the_first_lines_say_what_where_mode_and_why():
    first, second, third = page(view_models.driving()).splitlines()[:3]
    assert re.fullmatch(r"vcu-gateway  can0 \(socketcan\) up +pid 812  up 12:44", first)
    assert second == " ACTIVE  drive: nothing limits it"
    assert third == "demand of bench; drive; disarm to end"


def test_an_older_gateway_without_a_summary_is_shown_with_its_sentence():
    view = view_models.driving()
    del view.why["summary"]
    assert page(view).splitlines()[1] == " ACTIVE  demand of bench; drive; disarm to end"
    assert plain("vcu-gateway", view).splitlines()[1].startswith("active; demand of bench")
    view = view_models.faulty()
    del view.why["summary"]
    assert page(view).splitlines()[1].startswith(" FAULT  next: first: BMS_Status.Overtemperature")


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 40)])
def test_what_one_waits_for_stands_beside_the_mode(width, height):
    faulty = page(view_models.faulty(), width, height).splitlines()
    assert faulty[1] == f" FAULT  {view_models.faulty().why['summary']}"
    starting = page(view_models.starting(), width, height).splitlines()
    assert starting[1].startswith(" STARTING  waiting: another sender of our frames")


def test_the_drive_mode_stands_in_the_first_line_and_the_one_that_waits_beside_it():
    assert "drive mode" not in page(view_models.driving())
    tuned = view_models.tuned()
    assert (
        page(tuned).splitlines()[0].startswith("vcu-gateway  can0 (socketcan) up  drive mode eco ")
    )
    waiting = page(view_models.tuned(requested="sport")).splitlines()
    assert "  drive mode eco, sport waits " in waiting[0]
    assert any(
        re.fullmatch(r"wait +drive mode sport waits for the pedal's release", one)
        for one in waiting
    )
    gone = dataclasses.replace(tuned, problem=view_models.unreachable().problem)
    assert "drive mode" not in page(gone)


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 40)])
def test_pedals_on_can_have_a_line_and_without_them_there_is_none(width, height):
    assert not pedal_rows(view_models.driving(), width, height)
    (row,) = pedal_rows(view_models.pedals(), width, height)
    assert "throttle 42 %, second track 41 %, difference 1 %, brake 0 %" in row
    doubted = view_models.pedals("Throttle1 at -20 % of its travel")
    (row,) = pedal_rows(doubted, width, height)
    assert "second track 41 %, brake 0 %; Throttle1 at -20 % of its travel" in row
    gone = dataclasses.replace(doubted, problem=view_models.unreachable().problem)
    assert not pedal_rows(gone, width, height), "what is old looks current"


def pedal_rows(view, width, height):
    return [one for one in page(view, width, height).splitlines() if one.startswith("pedals ")]


def test_a_curve_that_limits_is_named_by_what_it_limits_and_not_by_its_key():
    (row,) = [one for one in page(view_models.tuned()).splitlines() if one.startswith("cap ")]
    assert row.split("  ")[0] == "cap"
    assert " motor temperature 101 °C: power at most 10.8 kW   " in row


@pytest.mark.parametrize(
    ("mode", "style"),
    [
        ("starting", "yellow"),
        ("standby", "cyan"),
        ("active", "green"),
        ("fault", "red"),
        ("stopping", "yellow"),
    ],
)
def test_the_mode_stands_in_its_colour_and_as_a_word(mode, style):
    view = view_models.driving()
    view.state["mode"] = mode
    line = mode_lines(view, 80, 2)[0]
    assert line.plain.startswith(f" {mode.upper()} ")
    assert style in str(line.spans[0].style)


BOTH_DISOBEY = (
    "NOT OBEYED: PCU1 reports PowerCut normal, throttle 19.9 %,"
    " and PCU2 reports PowerCut normal, throttle 19.9 %; use the contactor"
)


@pytest.mark.parametrize(("width", "height"), SIZES[:4])
@pytest.mark.parametrize(
    ("stage", "sentence", "style"),
    [
        ("sent", "Stop sent; not seen on the bus for PCU2", "yellow"),
        ("cut", "Power is cut: PCU1 and PCU2 confirm", "green"),
        ("not obeyed", BOTH_DISOBEY, "bold reverse red"),
    ],
)
def test_what_is_known_of_a_stop_is_shown_whole(stage, sentence, style, width, height):
    view = view_models.faulty()
    view.state["stop"] = view_models.stop(stage, sentence)
    lines = upper_lines("vcu-gateway", view, width, height)
    assert sentence in " ".join(text_of(lines).split())
    assert style in styles(lines, sentence[:20])
    assert len(lines) <= height - 4


def test_where_the_gateway_is_not_reached_nothing_is_said_of_a_stop():
    gone, stopped = view_models.unreachable(), view_models.faulty()
    view = dataclasses.replace(stopped, problem=gone.problem)
    assert "Stop on the bus" in page(stopped)
    assert "Stop on the bus" not in page(view)


def test_commanded_stands_beside_actual():
    table = text_of(controller_lines(view_models.driving().state, roomy=True))
    assert re.search(r"PCU1 commanded +reported +PCU2 commanded +reported", table)
    assert re.search(r"throttle % +40\.0 +40\.2 +40\.0 +40\.2", table)
    assert re.search(r"mode +turbo forward +turbo forward +turbo forward +turbo forward", table)
    assert re.search(r"speed rpm +max 12000 +3\d{3} +max 12000 +3\d{3}", table)
    assert re.search(r"power W +max 60000 +5\d{3} +max 60000 +5\d{3}", table)
    assert re.search(r"battery +75\.\d V 6\d\.\d A +75\.\d V 6\d\.\d A", table)
    assert re.search(r"phase A +1\d\d\.\d +1\d\d\.\d", table)
    assert re.search(r"temp degC +25 / 25 +25 / 25", table)
    assert re.search(r"frame +0008A7D0#[0-9A-F]{16} +0008A8D0#[0-9A-F]{16}", table)


def test_a_power_cut_is_told_and_reported_as_such():
    view = view_models.driving()
    view.state["commands"]["PCU1"]["power_cut"] = True
    view.state["messages"]["PCU2_Status1"]["signals"]["PowerCut"]["raw"] = 1
    table = text_of(controller_lines(view.state, roomy=False))
    assert re.search(r"mode +POWER CUT +turbo forward +turbo forward +POWER CUT", table)


def test_regeneration_is_told_and_reported_beside_the_brake():
    view = view_models.driving()
    view.state["commands"]["PCU2"] |= {"brake_pct": 7.8, "regen_brake": True}
    view.state["messages"]["PCU1_Status1"]["signals"]["RegenBrake"]["raw"] = 1
    table = text_of(controller_lines(view.state, roomy=False))
    assert re.search(r"brake % +0\.0 +regen 0\.0 +regen 7\.8 +0\.0", table)


def test_what_the_kernel_took_last_is_shown_with_its_age_where_it_is_old():
    view = view_models.driving()
    view.state["commands"]["PCU1"]["sent"] = None
    view.state["commands"]["PCU2"]["sent"]["age_ms"] = 150.0
    table = text_of(controller_lines(view.state, roomy=True))
    assert re.search(r"frame +nothing sent +0008A8D0#\w{16}\n?$", table)
    view.state["commands"]["PCU2"]["sent"]["age_ms"] = 151.0
    table = text_of(controller_lines(view.state, roomy=True))
    assert re.search(r"0008A8D0#\w{16} 151 ms\n?$", table)


@pytest.mark.parametrize("quality", ["out of range", "saturated", "stale"])
def test_a_value_that_is_not_good_is_marked_whatever_the_colours(quality):
    view = view_models.driving()
    view.state["messages"]["PCU1_Status2"]["signals"]["MotorSpeed"]["quality"] = quality
    table = text_of(controller_lines(view.state, roomy=False))
    assert re.search(r"speed rpm +max 12000 +3\d{3}! +max 12000 +3\d{3}\n", table)
    assert re.search(rf"MotorSpeed +3\d{{3}} rpm +{quality}\b", signals(view))


def test_the_power_is_marked_where_voltage_or_current_is_not_good():
    for name in ("BatteryVoltage", "BatteryCurrent"):
        view = view_models.driving()
        view.state["messages"]["PCU1_Status2"]["signals"][name]["quality"] = "stale"
        table = text_of(controller_lines(view.state, roomy=False))
        assert re.search(r"power W +max 60000 +5\d{3}! +max 60000 +5\d{3}\n", table)


def test_what_was_never_received_is_a_dash_and_the_word_never():
    view = view_models.starting()
    assert re.search(r"speed rpm +max 12000 +- +max 12000 +-\n", page(view))
    assert re.search(r"PCU1_Status2 +never +stale", signals(view))
    assert re.search(r"MotorSpeed +- rpm +never", signals(view))


def test_a_report_without_a_value_is_a_dash_and_so_is_what_is_worked_out_from_it():
    view = view_models.driving()
    of_pcu1 = {kind: view.state["messages"][f"PCU1_{kind}"]["signals"] for kind in KINDS}
    of_pcu1["Status1"]["PowerMode"]["raw"] = None
    of_pcu1["Status2"]["BatteryCurrent"]["value"] = None
    table = text_of(controller_lines(view.state, roomy=False))
    assert re.search(r"mode +turbo forward +- forward +turbo forward +turbo forward", table)
    assert re.search(r"power W +max 60000 +- +max 60000 +5\d{3}", table)


def test_every_signal_has_value_unit_and_quality_and_its_message_age_and_rate():
    view = view_models.driving()
    listed = signals(view)
    assert re.search(r"BMS_Status +456 ms old +2\.0 Hz\n", listed)
    assert re.search(r"  PackVoltage +75\.\d\d V +good", listed)
    assert re.search(r"  SOC +80 % +good", listed)
    assert re.search(r"  VoltageLevel +low_to_high +good", listed)
    assert re.search(r"IMU_Acceleration +4 ms old +100\.0 Hz\n", listed)
    names = {name for one in view.state["messages"].values() for name in one["signals"]}
    assert all(f"  {name} " in listed for name in names)


def test_a_good_value_is_green_by_its_word_alone_and_a_stale_one_is_red():
    view = view_models.faulty()
    lines = signal_lines(view.state, 80)
    assert "green" in styles(lines, "PackVoltage")
    assert "red" in styles(lines, "PowerMode")
    assert "green" not in styles(lines, "PowerMode")


def test_two_columns_of_signals_hold_all_that_one_holds():
    view = view_models.driving()
    one, two = (signal_lines(view.state, width) for width in (80, 120))
    assert len(two) <= len(one) / 2 + 13  # messages are not torn apart
    for line in one:
        words = line.plain.split()[0]
        assert any(words in other.plain for other in two)


def test_a_filter_shows_the_messages_and_signals_with_that_in_their_name():
    view = view_models.driving()
    by_message = signals(view, wanted="bms_temp")
    assert by_message.splitlines()[0].startswith("BMS_Temperatures")
    assert len(by_message.splitlines()) == 6
    by_signal = signals(view, wanted="motorspeed")
    assert [line.split()[0] for line in by_signal.splitlines()] == [
        "PCU1_Status2",
        "MotorSpeed",
        "PCU2_Status2",
        "MotorSpeed",
    ]
    assert "“xyz”" in signals(view, wanted="xyz")


def test_every_reason_is_there_with_its_effect_and_since_when():
    text = page(view_models.faulty(), 120, 40)
    assert re.search(r"latched +until a service reset: BMS_Status.* 4\.3 s\n", text)
    assert re.search(r"cut +BMS_Status.Overtemperature 2 \(level2\) +3\.2 s\n", text)
    assert re.search(r"power limit +PCU1_Status1 1700 ms, stale +3\.2 s \(gone\)", text)
    assert re.search(r"alarm +ARD2_SteeringWheel never received, stale +3\.2 s\n", text)
    assert re.search(r"next +first: BMS_Status.*; then service reset\n", text)
    sentence = view_models.faulty().why["sentence"].removeprefix("fault; ")
    assert sentence in " ".join(text.split())


def test_in_a_small_terminal_the_reasons_and_the_next_step_are_there_too():
    text = page(view_models.faulty())
    for label in ("latched", "cut", "power limit", "alarm"):
        assert re.search(rf"^{label} ", text, re.MULTILINE)
    told = " ".join(text.split())
    assert "next: first: BMS_Status.Overtemperature 2 (level2) stands; then service reset" in told


def test_what_is_waited_for_is_there():
    text = page(view_models.starting())
    assert re.search(r"^wait +listening for another sender of our frames", text, re.MULTILINE)


def test_reasons_that_have_no_room_are_counted():
    why = view_models.faulty().why
    why["alarms"] *= 9
    lines = text_of(reason_lines(why, 80, 4)).splitlines()
    assert len(lines) == 4
    assert lines[-1].split() == ["and", "9", "more"]


def test_the_bus_is_told_in_counts_and_what_ought_to_be_0_stands_out():
    healthy, broken = view_models.driving().health, view_models.faulty().health
    text = text_of(short_lines(broken))
    for words in ("up 12:43", "received 273294", "sent 30496", "rejected 4", "dropped 12"):
        assert words in text
    assert re.search(r"done 15268 +skipped 2 +late ms p50 0\.10  p99 0\.22  max 0\.24", text)
    assert "yellow" in styles(short_lines(broken), "dropped 12")
    assert "yellow" not in styles(short_lines(healthy), "dropped 0")


def test_where_there_is_room_the_reasons_behind_the_counts_are_told():
    text = text_of(panel_lines(view_models.faulty().health, 60))
    assert re.search(r"rejected +unknown 3, length 1", text)
    assert re.search(r"confirmed +PCU1 15248, PCU2 15248", text)


@pytest.mark.parametrize(
    ("state", "style"),
    [("up", "green"), ("error warning", "yellow"), ("error passive", "red"), ("bus off", "red")],
)
def test_the_link_stands_in_its_colour_and_as_a_word(state, style):
    health = view_models.driving().health
    health["link"]["state"] = state
    for lines in (short_lines(health), panel_lines(health, 60)):
        assert state in lines[0].plain
        assert style in styles(lines, state)


def test_a_lost_link_says_why():
    health = view_models.driving().health
    health["link"] |= {"state": "lost", "lost": "can0 is down"}
    assert "can0 is down" in panel_lines(health, 60)[0].plain


def test_a_gateway_that_has_gone_is_said_to_be_and_its_values_are_old():
    text = page(view_models.unreachable())
    assert " NOT REACHABLE  since 14:03:11, trying again: /run/vcu" in text
    assert "old values" in text
    for size in ((80, 24), (120, 40)):
        lines = upper_lines("vcu-gateway", view_models.unreachable(), *size)
        assert styles(lines, "PCU1 commanded") == "dim"
        assert not re.search("green|red", styles(lines, "received"))
    assert "ACTIVE" not in text
    listed = signals(view_models.unreachable(), old=True)
    assert re.search(r"PackVoltage +75\.\d\d V +old", listed)
    assert not re.search(r"good$|ms old|Hz", listed, re.MULTILINE)


def test_before_the_first_answer_it_says_that_it_waits():
    assert page(ViewModel()).splitlines()[1].startswith(" CONNECTING  waiting for the gateway")


def test_a_picture_that_stands_still_says_so():
    assert "PAUSED" in title_line("vcu-gateway", view_models.driving(), 80, paused=True).plain


def test_as_plain_text_the_sentence_is_whole_and_no_word_is_torn():
    text = plain("vcu-gateway demo", view_models.faulty())
    assert view_models.faulty().why["sentence"] in " ".join(text.split())
    assert re.search(r"ARD2_SteeringWheel +never ", text)
    assert re.search(r"PCU1_Status2 +49 +20\.0  .*MotorSpeed 3\d{3} rpm", text, re.DOTALL)
    assert "MotorSpeed 6400 rpm!" in text
    assert "\u00a0" not in text
    assert max(map(len, text.splitlines())) <= 120


def test_a_cell_is_exactly_as_wide_as_it_is_told():
    assert cell("ab", 4).plain == "ab  "
    assert cell("ab", 4, align=">").plain == "  ab"
    assert cell("abcdef", 4).plain == "abc…"
    assert cell("abcdef", -1).plain == ""


def test_a_long_sentence_ends_with_an_ellipsis():
    lines = wrapped("word " * 40, 40, 2, indent=10)
    assert len(lines) == 2
    assert len(lines[0]) <= 30
    assert lines[1].endswith("…")
    assert wrapped("", 40, 2) == [""]


def test_the_view_models_are_not_shared():
    before = copy.deepcopy(view_models.driving())
    view_models.faulty()
    assert view_models.driving() == before
