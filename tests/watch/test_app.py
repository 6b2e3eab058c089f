"""The view's keys, on a terminal that Textual plays."""

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest
from textual.color import Color
from textual.pilot import Pilot

from tests.watch import view_models
from tests.watch.screenshot import draw
from vcu_gateway.watch import app as app_module
from vcu_gateway.watch.app import LinesWidget, WatchApp

WAIT_S = 60.0
BLACK = Color(0, 0, 0)


class Shown:
    """The view and what is on its screen."""

    def __init__(self, pilot: Pilot, source: view_models.Scripted) -> None:
        self.pilot = pilot
        self.source = source

    @property
    def screen(self) -> str:
        app = self.pilot.app
        strips = app.screen._compositor.render_strips()
        return "\n".join("".join(segment.text for segment in strip).rstrip() for strip in strips)

    @property
    def last_line(self) -> str:
        return self.screen.splitlines()[-1]

    async def press(self, *keys: str) -> None:
        await self.pilot.press(*keys)

    async def until(self, condition: Callable[[], object]) -> None:
        """Wait for what has to come, however slow this machine is."""
        async with asyncio.timeout(WAIT_S):
            while not condition():
                await self.pilot.pause(0.02)


@contextlib.asynccontextmanager
async def shown(size=(80, 24), source=None, **options) -> AsyncIterator[Shown]:
    source = source or view_models.Scripted()
    app = WatchApp(source, refresh_hz=20, **options)
    async with app.run_test(size=size) as pilot:
        view = Shown(pilot, source)
        await view.until(lambda: source.looks >= 2 and "q quit" in view.screen)
        yield view


def run(check: Callable[[Shown], Awaitable[None]], **options: Any) -> None:
    async def run_it() -> None:
        async with shown(**options) as view:
            await check(view)

    asyncio.run(run_it())


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_title_mode_controllers_bus_signals_and_keys_are_on_the_screen(size):
    async def check(view: Shown) -> None:
        lines = view.screen.splitlines()
        assert len(lines) == size[1]
        assert lines[0].startswith("vcu-gateway  can0 (socketcan) up")
        assert lines[1].startswith(" ACTIVE  drive: nothing limits it")
        assert re.search(r"PCU1 commanded +reported", view.screen)
        assert "received" in view.screen
        assert re.search(r"ARD2_SteeringWheel +57 ms old +10\.0 Hz", view.screen)
        assert re.match(r"q quit .*\? help +1-\d+/\d+$", view.last_line)

    run(check, size=size)


def test_in_80_by_24_eight_lines_of_signals_have_room_while_all_is_well():
    async def check(view: Shown) -> None:
        assert "1-8/74" in view.last_line

    run(check)


def test_a_bigger_terminal_shows_more_at_once():
    async def check(view: Shown) -> None:
        assert "protection" not in view.screen
        await view.pilot.resize_terminal(120, 40)
        await view.until(lambda: "protection" in view.screen)
        await view.until(lambda: "1-21/38" in view.last_line)
        await view.pilot.resize_terminal(80, 24)
        await view.until(lambda: "1-8/74" in view.last_line)

    run(check)


def test_a_tiny_terminal_breaks_nothing():
    async def check(view: Shown) -> None:
        await view.pilot.resize_terminal(30, 6)
        await view.until(lambda: len(view.screen.splitlines()) == 6)
        assert "ACTIVE" in view.screen

    run(check)


def test_the_signals_scroll_by_line_by_page_and_to_either_end():
    async def check(view: Shown) -> None:
        await view.press("down")
        await view.until(lambda: "2-9/74" in view.last_line)
        await view.press("pagedown")
        await view.until(lambda: "10-17/74" in view.last_line)
        await view.press("end")
        await view.until(lambda: "67-74/74" in view.last_line)
        assert "PCU2_Status2" in view.screen
        await view.press("up")
        await view.until(lambda: "66-73/74" in view.last_line)
        await view.press("home")
        await view.until(lambda: "1-8/74" in view.last_line)

    run(check)


def test_new_values_appear_by_themselves():
    async def check(view: Shown) -> None:
        view.source.view.state["messages"]["PCU1_Status2"]["signals"]["MotorSpeed"]["value"] = 7
        await view.until(lambda: re.search(r"speed rpm +max 12000 +7 ", view.screen))

    run(check)


@pytest.mark.parametrize("key", ["space", "p"])
def test_a_paused_view_does_not_change_until_it_resumes(key):
    async def check(view: Shown) -> None:
        await view.press(key)
        await view.until(lambda: "PAUSED" in view.screen)
        looks = view.source.looks
        view.source.view = view_models.faulty()
        await view.pilot.pause(0.2)
        assert view.source.looks == looks
        assert "ACTIVE" in view.screen
        await view.press("end")
        await view.until(lambda: "67-74/74" in view.last_line)
        await view.press(key)
        await view.until(lambda: "FAULT" in view.screen)
        assert "PAUSED" not in view.screen

    run(check)


def test_m_shows_one_message_after_the_other_and_then_all():
    async def check(view: Shown) -> None:
        names = list(view.source.view.state["messages"])
        await view.press("m")
        await view.until(lambda: f"only {names[0]}" in view.last_line)
        assert names[1] not in view.screen
        await view.press("m")
        await view.until(lambda: f"only {names[1]}" in view.last_line)
        await view.press("M", "M")
        await view.until(lambda: "q quit" in view.last_line)
        await view.press("M")
        await view.until(lambda: f"only {names[-1]}" in view.last_line)
        await view.press("m")
        await view.until(lambda: "q quit" in view.last_line)

    run(check)


def test_a_text_to_find_narrows_while_it_is_written_and_stays_after_enter():
    async def check(view: Shown) -> None:
        await view.press("slash", *"speed")
        await view.until(lambda: "WheelSpeedFL" in view.screen and "SOC" not in view.screen)
        await view.press("enter")
        await view.until(lambda: "only speed" in view.last_line)
        assert "MotorSpeed" in view.screen
        await view.press("escape")
        await view.until(lambda: "q quit" in view.last_line)
        assert "SteeringAngle" in view.screen

    run(check)


def test_letters_of_a_text_to_find_do_nothing_else():
    async def check(view: Shown) -> None:
        await view.press("slash", *"qeEdDpm", "enter")
        await view.until(lambda: "only qeEdDpm" in view.last_line)
        assert view.pilot.app.is_running
        assert view.source.asked == []
        assert "PAUSED" not in view.screen

    run(check)


@pytest.mark.parametrize("key", ["question_mark", "h"])
def test_help_tells_every_key_in_80_by_24_and_goes_away(key):
    async def check(view: Shown) -> None:
        await view.press(key)
        await view.until(lambda: "emergency stop: cuts" in view.screen)
        assert "ARD2" not in view.screen
        for words in ("quit; the gateway goes on", "late ms", "old             the gateway"):
            assert words in view.screen
        await view.press(key)
        await view.until(lambda: "ARD2" in view.screen)
        assert "emergency stop: cuts" not in view.screen

    run(check)


@pytest.mark.parametrize(
    ("key", "what", "words"), [("e", "estop", "Emergency stop"), ("d", "disarm", "Disarm")]
)
def test_stopping_is_asked_about_and_done_with_the_capital_letter(key, what, words):
    async def check(view: Shown) -> None:
        await view.press(key)
        await view.until(lambda: view.last_line.startswith(f"{words}: "))
        assert f"Shift-{key.upper()} yes" in view.last_line
        assert view.source.asked == []
        await view.press(key.upper())
        await view.until(lambda: " granted" in view.last_line)
        assert view.source.asked == [what]

    run(check)


@pytest.mark.parametrize("keys", ["E", "D", "eD", "dE", "ee", "dd"])
def test_no_other_keys_stop_anything(keys):
    async def check(view: Shown) -> None:
        await view.press(*keys)
        await view.pilot.pause(0.1)
        assert view.source.asked == []

    run(check)


def test_escape_takes_the_question_back():
    async def check(view: Shown) -> None:
        await view.press("e", "escape", "E")
        await view.pilot.pause(0.1)
        assert view.source.asked == []
        assert "q quit" in view.last_line

    run(check)


def test_a_question_is_not_taken_back_by_an_earlier_one(monkeypatch):
    async def check(view: Shown) -> None:
        monkeypatch.setattr(app_module, "_NOTICE_S", 0.3)
        await view.press("d")
        await view.until(lambda: "q quit" in view.last_line)  # its time is over
        monkeypatch.setattr(app_module, "_NOTICE_S", 4.0)
        await view.press("d")
        await view.pilot.pause(2.0)
        await view.press("e")
        await view.pilot.pause(2.2)  # by now that of "d" would be over; that of "e" is not
        await view.press("E")
        await view.until(lambda: view.source.asked == ["estop"])

    run(check)


def test_a_late_answer_does_not_take_back_the_next_question():
    async def check(view: Shown) -> None:
        view.source.may_answer.clear()
        await view.press("d", "D")
        await view.until(lambda: view.source.asked == ["disarm"])
        await view.press("e")
        await view.until(lambda: "Emergency stop" in view.last_line)
        view.source.may_answer.set()
        await view.pilot.pause(0.2)
        assert "Emergency stop" in view.last_line
        await view.press("E")
        await view.until(lambda: view.source.asked == ["disarm", "estop"])

    run(check)


def test_a_refusal_says_why():
    async def check(view: Shown) -> None:
        view.source.refusal = "the mode is standby"
        await view.press("d", "D")
        await view.until(lambda: "not granted: the mode is standby" in view.last_line)

    run(check)


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_a_key_quits(key):
    async def check(view: Shown) -> None:
        await view.press(key)
        await view.until(lambda: not view.pilot.app.is_running)
        assert view.pilot.app.return_code == 0

    run(check)


def test_it_ends_by_itself_when_it_is_over():
    over = []

    async def check(view: Shown) -> None:
        over.append(True)
        await view.until(lambda: not view.pilot.app.is_running)

    run(check, finished=lambda: bool(over))


def test_a_gateway_that_goes_away_and_comes_back_is_told_each_time():
    async def check(view: Shown) -> None:
        view.source.view = view_models.unreachable()
        await view.until(lambda: "NOT REACHABLE  since 14:03:11" in view.screen)
        assert re.search(r"SteeringAngle +\S+ deg +old", view.screen)
        view.source.view = view_models.driving()
        await view.until(lambda: "ACTIVE" in view.screen)
        assert not re.search(r"(?<!ms) old\b|^old", view.screen, re.MULTILINE)

    run(check)


def test_a_picture_that_does_not_change_writes_nothing():
    async def check(view: Shown) -> None:
        drawn: list[int] = []
        for lines in view.pilot.app.query(LinesWidget):
            lines.refresh_line = drawn.append  # type: ignore[assignment]  # overheard
        looks = view.source.looks
        await view.until(lambda: view.source.looks >= looks + 3)
        assert drawn == []
        view.source.view.state["messages"]["BMS_Status"]["signals"]["SOC"]["value"] = 7
        await view.until(lambda: drawn)
        assert len(set(drawn)) == 1

    run(check)


def colours(view: Shown) -> set[str]:
    """Every colour on the screen but the terminal's own."""
    filters = view.pilot.app.get_line_filters()
    found = set()
    for strip in view.pilot.app.screen._compositor.render_strips():
        segments = list(strip)
        for line_filter in filters:
            segments = line_filter.apply(segments, BLACK)
        for style in [segment.style for segment in segments if segment.style]:
            found |= {colour.name for colour in (style.color, style.bgcolor) if colour}
    return found


def test_there_are_colours_but_with_no_color_none_at_all(monkeypatch):
    async def coloured(view: Shown) -> None:
        assert {"green", "red", "yellow"} <= colours(view)

    async def colourless(view: Shown) -> None:
        assert colours(view) == set()
        await view.press("e")
        assert colours(view) == set()
        await view.press("slash")
        assert colours(view) == set()

    run(coloured, source=view_models.Scripted(view_models.faulty()))
    monkeypatch.setenv("NO_COLOR", "")
    run(coloured, source=view_models.Scripted(view_models.faulty()))
    monkeypatch.setenv("NO_COLOR", "1")
    run(colourless, source=view_models.Scripted(view_models.faulty()))


def test_old_values_are_dim():
    async def check(view: Shown) -> None:
        strips = view.pilot.app.screen._compositor.render_strips()
        for words in ("PCU1 commanded", "received", "SteeringAngle"):
            strip = next(strip for strip in strips if words in strip.text)
            assert all(one.style.dim for one in strip if one.text.strip())

    run(check, source=view_models.Scripted(view_models.unreachable()))


def test_the_readmes_picture_can_be_drawn_and_fetches_nothing():
    svg = asyncio.run(draw(120, 40))
    assert "ACTIVE" in svg
    assert "url(http" not in svg
    assert "url(&quot;http" not in svg
    assert "@font-face" not in svg
