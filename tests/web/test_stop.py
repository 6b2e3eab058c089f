"""The emergency stop in a real Chromium: what the page says is what is so, and no more."""

import os
import re
import signal

import pytest

from tests.driven import wait_until
from tests.web.browser import (
    PICTURES,
    context_of,
    is_old,
    opened,
    text,
    until_driving,
    until_old,
)
from tests.web.conftest import PASSWORD
from tests.web.stand import proxied, serving

CI = pytest.mark.ci
SIZES = {"360": (360, 740), "768": (768, 1024), "1280": (1280, 800)}

CUT_OFF = """() => [...document.querySelectorAll('.steps li, #alarm, #stop-outcome')]
  .filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.innerText)"""


def until_stage(page, stage: str) -> str:
    page.wait_for_selector(f"#stop-outcome[data-stage='{stage}']")
    return text(page, "#stop-outcome")


def pictures_of(page, stage: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    before = page.viewport_size
    for name, (width, height) in SIZES.items():
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(200)
        page.screenshot(path=PICTURES / f"stop-{stage.replace(' ', '-')}-{name}.png")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(CUT_OFF) == []
    page.set_viewport_size(before)


def colour(page) -> str:
    return page.get_attribute("#stop-outcome", "data-tone")


def steps_done(page) -> list[bool]:
    return page.evaluate(
        "[...document.querySelectorAll('.steps li')].map(one => 'done' in one.dataset)"
    )


@pytest.mark.usefixtures("stopped")
def test_a_stop_that_both_controllers_confirm_is_green_and_says_what_is_known(
    gateway, context, web
):
    page, seen = opened(context, web.url)
    until_driving(gateway, page)
    page.click("#stop")
    said = until_stage(page, "cut")
    assert "Power is cut: PCU1 and PCU2 confirm" in said
    assert re.search(r"asked for at \d\d:\d\d:\d\d\.\d{3}, answered after \d+ ms", said)
    assert steps_done(page) == [True, True, True]
    assert colour(page) == "good"
    assert set(gateway.ask("cuts")) == {"PCU1", "PCU2"}
    assert text(page, ".sentence") == "Power is cut: PCU1 and PCU2 confirm"
    assert text(page, ".why-line").startswith("fault; latched (service): emergency stop")
    assert not page.is_visible("#alarm")
    pictures_of(page, "cut")
    assert seen.errors == []


@pytest.mark.usefixtures("stopped")
def test_a_controller_that_ignores_the_stop_is_an_alarm_until_it_obeys(gateway, context, web):
    page, _ = opened(context, web.url)
    until_driving(gateway, page)
    gateway.ask("deafen", "PCU1")
    page.wait_for_timeout(600)
    page.click("#stop")
    said = until_stage(page, "not obeyed")
    assert re.search(r"NOT OBEYED: PCU1 reports PowerCut normal, throttle [\d.]+ %", said)
    assert colour(page) == "bad"
    assert steps_done(page) == [True, True, False]
    page.wait_for_selector("#alarm[data-sound=on]")
    assert "NOT OBEYED: use the contactor" in text(page, "#alarm")
    assert "PCU1 reports PowerCut normal" in text(page, "#alarm-what")
    assert "PCU2" not in text(page, "#alarm-what")
    pictures_of(page, "not obeyed")
    gateway.ask("deafen")
    until_stage(page, "cut")
    assert colour(page) == "good"
    page.wait_for_function(
        "() => !document.getElementById('alarm-what').textContent.includes('PowerCut')"
    )


@pytest.mark.ci
@pytest.mark.usefixtures("stopped")
def test_the_alarms_sound_can_be_silenced_for_a_while_and_comes_back(gateway, context, web):
    page, _ = opened(context, web.url)
    until_driving(gateway, page)
    gateway.ask("deafen", "PCU2")
    page.wait_for_timeout(600)
    page.click("#stop")
    page.wait_for_selector("#alarm[data-sound=on]")
    page.click("#alarm-mute")
    page.wait_for_selector("#alarm[data-sound=off]")
    assert re.match(r"Silent for \d+ s", text(page, "#alarm-mute"))
    assert "NOT OBEYED" in text(page, "#alarm")
    page.wait_for_selector("#alarm[data-sound=on]")


@pytest.mark.usefixtures("stopped")
def test_a_controller_that_gives_more_than_commanded_is_the_same_alarm(gateway, context, web):
    page, _ = opened(context, web.url)
    until_driving(gateway, page)
    gateway.ask("deafen", "PCU1")
    page.wait_for_timeout(600)
    gateway.ask("park")
    page.wait_for_selector("#alarm:not([hidden])")
    assert re.search(r"PCU1 Throttle: [\d.]+ %, commanded 0.0 %", text(page, "#alarm-what"))
    assert not page.is_visible("#stop-outcome"), "nobody has stopped it"


@pytest.mark.parametrize(
    ("interface", "stage", "missing", "steps"),
    [("away", "sent", "not seen on the bus", 1), ("full", "latched", "not sent", 0)],
)
@pytest.mark.usefixtures("stopped")
def test_a_stop_that_is_not_on_the_bus_is_not_said_to_be(
    gateway, context, web, interface, stage, missing, steps
):
    page, _ = opened(context, web.url)
    gateway.ask("interface", interface)
    page.click("#stop")
    said = until_stage(page, stage)
    assert f"Stop {stage}; {missing}" in said
    assert f"PCU1 {missing}" in said
    assert f"PCU2 {missing}" in said
    assert colour(page) == "warn"
    assert steps_done(page) == [steps > place for place in range(3)]
    assert page.inner_text("#cut").lower() == f"stop {stage}"
    pictures_of(page, stage)


@pytest.mark.usefixtures("stopped")
def test_controllers_that_say_nothing_leave_the_stop_on_the_bus(gateway, context, web):
    page, _ = opened(context, web.url)
    gateway.ask("silence", "PCU1_Status1")
    page.click("#stop")
    said = until_stage(page, "on the bus")
    assert steps_done(page) == [True, True, False]
    assert colour(page) == "warn"
    assert "PCU1 has not confirmed yet" in said
    page.wait_for_selector("#stop-outcome strong:text('Stop sent; PCU1 does not confirm')")
    assert colour(page) == "warn"
    pictures_of(page, "on the bus")


@pytest.mark.usefixtures("stopped")
def test_a_stop_loses_its_colour_while_the_page_is_old(gateway, context, web):
    with proxied(web.port) as proxy:
        page, _ = opened(context, proxy.url)
        page.click("#stop")
        until_stage(page, "cut")
        proxy.stall()
        until_old(page, True)
        filters = "getComputedStyle(document.getElementById('stop-outcome')).filter"
        assert "grayscale(1)" in page.evaluate(filters)
        pictures_of(page, "old")
        proxy.flow()
        until_old(page, False)
        assert page.evaluate(filters) == "none"


@pytest.mark.usefixtures("stopped")
def test_a_stop_is_gone_with_its_latch_and_stays_gone_in_the_next_drive(gateway, context, web):
    page, _ = opened(context, web.url)
    page.click("#stop")
    until_stage(page, "cut")
    gateway.ask("reset")
    page.wait_for_selector("#stop-outcome", state="hidden")
    until_driving(gateway, page)
    assert not page.is_visible("#stop-outcome")
    assert not page.is_visible("#cut")


@pytest.mark.clock
@pytest.mark.usefixtures("stopped")
def test_a_stop_that_nobody_answers_says_to_use_the_contactor_and_goes_on(gateway, context, web):
    page, _ = opened(context, web.url)
    os.kill(gateway.process.pid, signal.SIGSTOP)
    try:
        page.click("#stop")
        said = until_stage(page, "unconfirmed")
        assert "NOT CONFIRMED: use the contactor" in said
        assert is_old(page)
        page.screenshot(path=PICTURES / "not-confirmed-1024.png")
    finally:
        os.kill(gateway.process.pid, signal.SIGCONT)
    until_stage(page, "cut")


@pytest.mark.ci
@pytest.mark.usefixtures("stopped")
def test_an_answer_that_comes_after_two_seconds_still_counts(gateway, context, web):
    with proxied(web.port) as proxy:
        page, _ = opened(context, proxy.url)
        proxy.delay_s = 1.2  # each way; silent for two seconds, the page would begin another stream
        page.click("#stop")
        assert "NOT CONFIRMED: use the contactor" in until_stage(page, "unconfirmed")
        page.wait_for_function(
            "() => /answered after \\d+ ms/.test(document.getElementById('stop-outcome').innerText)"
        )
        said = until_stage(page, "cut")
        assert int(re.search(r"answered after (\d+) ms", said)[1]) > 2000
    asked = [one for one in web.events("action_asked") if one["action"] == "estop"]
    assert asked[-1]["granted"]


# Without a session.


@pytest.fixture
def guarded(tmp_path, gateway, users_file):
    with serving(tmp_path, gateway.socket_path, "--users", str(users_file)) as one:
        yield one


def sign_in(page) -> None:
    page.fill("#sign-in-name", "anna")
    page.fill("#sign-in-password", PASSWORD)
    page.press("#sign-in-password", "Enter")
    page.wait_for_selector("#pulse[data-live=yes]")


@pytest.mark.usefixtures("stopped")
def test_a_stop_of_nobody_is_asked_for_at_a_sign_in_that_follows_at_once(gateway, context, guarded):
    page = context.new_page()
    page.goto(guarded.url)
    page.wait_for_selector("#sign-in[open]")
    page.click("#stop")
    said = until_stage(page, "unconfirmed")
    assert "nobody is signed in here" in said
    sign_in(page)
    until_stage(page, "cut")


@pytest.mark.ci
def test_a_stop_of_nobody_ends_and_a_later_sign_in_does_not_ask_for_it(gateway, context, guarded):
    page = context.new_page()
    page.goto(guarded.url)
    page.wait_for_selector("#sign-in[open]")
    page.click("#stop")
    assert "NOT asked for: nobody signed in within 5 s" in until_stage(page, "ended")
    sign_in(page)
    page.wait_for_timeout(1000)
    assert guarded.events("action_asked") == []
    assert gateway.ask("mode") != "fault"


def test_a_stop_of_nobody_can_be_cancelled(gateway, context, guarded):
    page = context.new_page()
    page.goto(guarded.url)
    page.wait_for_selector("#sign-in[open]")
    page.click("#stop")
    page.click("text=Cancel the stop")
    assert "NOT asked for: cancelled" in until_stage(page, "ended")
    page.click("text=Close")
    assert not page.is_visible("#stop-outcome")
    sign_in(page)
    page.wait_for_timeout(1000)
    assert guarded.events("action_asked") == []


@CI
@pytest.mark.usefixtures("stopped")
def test_a_stop_needs_no_session_that_has_not_ended(browser, tmp_path, gateway, users_file):
    options = ("--users", str(users_file), "--session-hours", "0.002")
    with serving(tmp_path, gateway.socket_path, *options) as web, context_of(browser) as context:
        page = context.new_page()
        page.goto(web.url)
        page.fill("#sign-in-name", "anna")
        page.fill("#sign-in-password", "wrong")
        page.press("#sign-in-password", "Enter")
        page.wait_for_selector("#sign-in-problem:text('name or password is wrong')")
        page.screenshot(path=PICTURES / "sign-in-1024.png")
        sign_in(page)
        page.wait_for_selector("#sign-in[open]", timeout=30_000)
        assert "The session has ended" in text(page, "#sign-in-why")
        until_old(page, True)
        page.click("#stop")
        page.wait_for_selector("#stop-outcome[data-stage=granted]")
        assert "nothing is known yet of the bus" in text(page, "#stop-outcome")
    wait_until(lambda: gateway.ask("mode") == "fault", "the stop")
