"""The page in a real Chromium, beside a real gateway and a simulated vehicle."""

import contextlib
import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from tests.web.browser import (
    PICTURES,
    WIDTHS,
    context_of,
    is_old,
    opened,
    text,
    until_driving,
    until_old,
)
from tests.web.other_shapes import variants
from tests.web.stand import AlteringRelay, serving

CI = pytest.mark.ci
narrowest, *wider = WIDTHS
VIEWS = ("why", "signals", "plots", "events", "bus", "recordings", "tuning")

# What is shown.


@pytest.mark.parametrize("width", [narrowest, *(pytest.param(one, marks=CI) for one in wider)])
def test_every_view_is_whole_at_this_width_and_asks_nobody_else(browser, web, width):
    PICTURES.mkdir(parents=True, exist_ok=True)
    with context_of(browser, width) as context:
        page, seen = opened(context, web.url)
        for view in VIEWS:
            page.goto(f"{web.url}#{view}")
            page.wait_for_selector(f"#view-{view}:not([hidden])")
            page.wait_for_timeout(700)
            wide = page.evaluate("document.documentElement.scrollWidth")
            assert wide <= width, f"{view} is {wide} wide"
            page.screenshot(path=PICTURES / f"{view}-{width}.png")
            assert page.is_visible("#stop")
        assert seen.errors == []
        assert {address for address in seen.addresses if not address.startswith(web.url)} == set()


def test_on_a_low_screen_what_matters_is_there_without_scrolling(gateway, context, web):
    page, _ = opened(context, web.url)
    page.set_viewport_size({"width": 1280, "height": 800})
    gateway.ask("reset")
    page.wait_for_selector("#mode[data-mode=standby]")
    page.wait_for_timeout(1200)
    page.screenshot(path=PICTURES / "now-1280.png")
    ends = page.evaluate(
        "['.why', '.controller', '.battery .soc', '.act'].map((one) =>"
        " document.querySelector(one).getBoundingClientRect()[one === '.act' ? 'top' : 'bottom'])"
    )
    assert ends == sorted(ends), "why, controllers and battery are above the buttons"


def test_the_heading_is_there_at_every_width(browser, web):
    with context_of(browser, narrowest) as context:
        page, _ = opened(context, web.url)
        assert page.get_by_role("heading", level=1).inner_text() == "vcu-gateway"


def test_on_paper_there_are_values_and_no_buttons(context, web):
    page, _ = opened(context, web.url)
    page.emulate_media(media="print")
    assert page.is_visible(".controller")
    assert not page.is_visible("#stop")
    assert not page.is_visible("#views")
    ground = "getComputedStyle(document.querySelector('.panel')).backgroundColor"
    assert page.evaluate(ground) == "rgb(255, 255, 255)"


def test_the_colours_are_the_systems_until_others_are_chosen(context, web):
    page, _ = opened(context, web.url)
    is_light = "() => getComputedStyle(document.body).backgroundColor === 'rgb(238, 241, 245)'"
    assert not page.evaluate(is_light)
    page.emulate_media(color_scheme="light")
    page.wait_for_function(is_light)
    page.get_by_label("Colours: as the system has them").click()
    assert not page.evaluate(is_light)
    page.get_by_label("Colours: dark").click()
    page.emulate_media(color_scheme="dark")
    assert page.evaluate(is_light)
    page.get_by_label("Colours: light").click()
    page.wait_for_function(f"() => !({is_light})()")


def test_how_long_a_recording_lasted_has_no_60_seconds(context, web):
    one = {"name": "20260101T000000Z-drive", "kind": "drive", "reasons": [], "problems": []}
    recordings = [one | {"size_bytes": 1000, "duration_s": 119.7}]
    context.route(
        "**/api/recordings",
        lambda route: route.fulfill(json={"recordings": recordings, "sentence": ""}),
    )
    page, seen = opened(context, web.url, "recordings")
    page.wait_for_selector(".recording .muted:text('2 min 0 s')")
    assert seen.errors == []


def test_codes_are_shown_as_words(context, web):
    page, _ = opened(context, web.url)
    page.wait_for_selector(".controller .wide .v:text('low to high')")


def test_why_is_the_largest_text_of_the_page(gateway, context, web):
    page, _ = opened(context, web.url)
    gateway.ask("reset")
    page.wait_for_selector(".next:not([hidden])")
    sizes = page.evaluate(
        "[...document.querySelectorAll('#view-why *')].map(one => "
        "[parseFloat(getComputedStyle(one).fontSize), one.className])"
    )
    assert max(sizes)[1] == "sentence"
    # While a busy machine has it begin anew, all that is next is to wait.
    then, now = page.wait_for_function(
        "() => document.querySelector('#mode').dataset.mode === 'standby' &&"
        " ['.next span', '.sentence'].map((one) => document.querySelector(one).innerText)",
        timeout=60_000,
    ).json_value()
    assert then not in now, "it says nothing twice"
    page.wait_for_selector(".sentence:text('waiting for ')")
    assert text(page, ".why-line").startswith("standby")


@pytest.mark.parametrize(
    ("width", "colours"),
    [
        (360, "dark"),
        pytest.param(360, "light", marks=CI),
        pytest.param(1920, "dark", marks=CI),
        pytest.param(1920, "light", marks=CI),
    ],
)
def test_nothing_keeps_out_a_screen_reader_or_a_keyboard(browser, web, colours, width):
    fetched = subprocess.run(
        [Path(__file__).with_name("fetch-axe")], capture_output=True, text=True, check=True
    )
    axe = Path(fetched.stdout.strip()).read_text()
    with context_of(browser, width) as context:
        page, _ = opened(context, web.url)
        page.emulate_media(color_scheme=colours)
        page.evaluate(axe)
        for view in VIEWS:
            page.goto(f"{web.url}#{view}")
            page.wait_for_timeout(400)
            found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
            serious = [
                (one["id"], one["impact"], [node["html"][:120] for node in one["nodes"][:3]])
                for one in found["violations"]
                if one["impact"] in ("serious", "critical")
            ]
            assert serious == [], view
            if colours == "light":
                page.screenshot(path=PICTURES / f"{view}-{width}-light.png")


@pytest.mark.ci
def test_numbers_do_not_jump_while_the_vehicle_drives(gateway, context, web):
    page, _ = opened(context, web.url)
    until_driving(gateway, page)
    page.wait_for_timeout(1500)
    moved = page.evaluate(
        """async () => {
          const values = [...document.querySelectorAll('#view-why td .v, #view-why .rows .n .v')];
          const edge = (one) => Math.round(one.getBoundingClientRect().right * 10);
          const first = values.map(edge);
          const moved = new Set();
          let texts = new Set();
          for (let i = 0; i < 60 || (texts.size <= 20 && i < 1200); i++) {  // a machine may be busy
            await new Promise((done) => setTimeout(done, 50));
            texts.add(values.map((one) => one.textContent).join());
            values.forEach((one, n) => edge(one) !== first[n] && moved.add(one.textContent));
          }
          return [values.length, texts.size, [...moved]];
        }"""
    )
    gateway.ask("park")
    gateway.ask("reset")
    assert moved[0] > 20
    assert moved[1] > 20, "the values change"
    assert moved[2] == []


def test_a_signal_is_found_by_typing_and_has_value_unit_quality_and_age(context, web):
    page, _ = opened(context, web.url, "signals")
    page.get_by_role("searchbox", name="Find a signal").fill("pack volt")
    rows = page.locator(".groups tr:visible", has=page.locator(".v"))
    assert rows.count() == 1
    shown = rows.first.inner_text()
    assert re.search(r"Pack\s*Voltage\s+[\d.]+ V\s+good\s+\d+ ms", shown), shown


ONE_STALE_AND_THE_OTHERS_LIVE = """() => {
  const count = (message, quality) => document.querySelectorAll(
    `section[aria-label=${message}] .v[data-q=${quality}]`).length;
  return count('BMS_Temperatures', 'stale') > 0 && count('IMU_Attitude', 'live') === 3
    && !('old' in document.documentElement.dataset);
}"""


def test_each_value_greys_by_its_own_age_and_the_others_stay_live(gateway, context, web):
    page, _ = opened(context, web.url, "signals")
    gateway.ask("silence", "BMS_Temperatures")
    page.wait_for_function(ONE_STALE_AND_THE_OTHERS_LIVE)
    gateway.ask("silence")
    page.wait_for_selector("section[aria-label=BMS_Temperatures] .v[data-q=live]")
    gateway.ask("reset")


def test_a_plot_has_what_the_server_kept_before_the_page_was_there(context, web):
    time.sleep(2)
    page, _ = opened(context, web.url, "plots")
    page.get_by_label("Add a signal to the plots").fill("IMU_Acceleration.AccelerationZ")
    page.get_by_label("Add a signal to the plots").press("Enter")
    page.wait_for_selector("section[aria-label='Plot, m/s2'], section[aria-label='Plot, m/s²']")
    drawn = page.evaluate(
        """() => {
          const canvas = document.querySelector('.charts canvas');
          const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
          return data.some((value) => value > 0);
        }"""
    )
    assert drawn


KEEP_PLOTS = """() => {
  const Plot = uPlot;
  window.kept = [];
  window.uPlot = function (...given) {
    const one = new Plot(...given);
    kept.push(one);
    return one;
  };
}"""

# What is commanded is never stale.
COMMANDED = "kept.findLast((one) => one.series[1].label === 'PCU1.commanded.throttle_pct')?.data[1]"


def test_a_plot_has_a_gap_where_nothing_came_while_it_was_shown(gateway, context, web):
    page, _ = opened(context, web.url)
    page.evaluate(KEEP_PLOTS)
    page.evaluate("location.hash = '#plots'")
    page.wait_for_function(f"() => {COMMANDED}?.length > 10")
    page.wait_for_timeout(1000)
    had = page.evaluate(f"{COMMANDED}.filter((value) => value === null).length")
    os.kill(gateway.process.pid, signal.SIGSTOP)
    page.wait_for_timeout(700)
    os.kill(gateway.process.pid, signal.SIGCONT)
    gaps = f"{COMMANDED}.filter((value) => value === null).length"
    page.wait_for_function(f"(had) => {gaps} > had", arg=had)
    gateway.ask("reset")


def test_the_times_of_events_and_stops_are_those_of_the_server(context, web):
    context.add_init_script(
        "Date = class extends Date { constructor(...given) {"
        " super(...(given.length ? given : [0])); } };"
    )
    page, _ = opened(context, web.url)
    shown = page.evaluate("import('/model.js').then((model) => model.timeNow().getTime())")
    assert abs(shown / 1000 - time.time()) < 60


def test_plots_of_signals_that_are_no_more_ask_for_nothing(context, web):
    context.add_init_script("localStorage.setItem('plots', '[\"Nothing.Here\"]')")
    page, seen = opened(context, web.url, "plots")
    page.wait_for_timeout(1000)
    assert [one for one in seen.addresses if "/api/history" in one] == []
    assert seen.errors == []


# Answers of another shape.

TAKE_EACH = """async ([sections, variants]) => {
  const {hear} = await import('/stream.js'), {failures} = await import('/model.js');
  const shown = [...document.querySelectorAll('#views a')].map((one) => one.hash.slice(1));
  const views = await Promise.all(shown.map(
    (name) => import(`/view-${name === 'why' ? 'now' : name}.js`)));
  const {renderStop} = await import('/stop.js'), {renderAlarm} = await import('/alarm.js');
  const failed = [];
  for (const [section, text, what] of variants) {
    for (const [name, whole] of Object.entries(sections)) if (name !== section) hear(name, whole);
    hear(section, text);
    try {
      for (const view of views) view.draw?.();
      renderStop();
      renderAlarm();
    } catch (error) {
      failed.push([section, what, String(error)]);
    }
    for (const [part, error] of failures) failed.push([section, what, part, error]);
    failures.clear();
  }
  for (const [name, whole] of Object.entries(sections)) hear(name, whole);
  return failed;
}"""


@pytest.mark.ci
@pytest.mark.usefixtures("stopped")
def test_every_field_of_another_shape_fails_nothing_in_the_browser(context, web):
    web.act("estop")
    with web.stream() as stream:
        sections = {name: stream.until(name) for name in ("definition", "why", "health", "events")}
        sections["state"] = stream.until("state", lambda state: state["stop"])
        sections["link"] = stream.until("link")
    for message in sections["definition"]["messages"]:
        message["signals"] = message["signals"][:1]
    texts = {name: json.dumps(value) for name, value in sections.items()}
    changed = [
        (name, json.dumps(variant.answer), str(variant))
        for name, value in sections.items()
        for variant in variants(value)
    ]
    page, seen = opened(context, web.url)
    assert page.evaluate(TAKE_EACH, [texts, changed]) == []
    until_old(page, False)
    assert page.inner_text(".sentence")
    assert seen.errors == []


def test_a_part_of_the_page_that_fails_is_named_and_stops_no_other(gateway, context, web):
    page, _ = opened(context, web.url)
    page.evaluate("document.getElementById('pulse-text').remove()")
    page.wait_for_selector("#notes:text('A part of this page failed (header)')")
    first = page.evaluate("import('/model.js').then((model) => model.model.state.t)")
    page.wait_for_function(
        "(first) => import('/model.js').then((model) => model.model.state.t > first)", arg=first
    )
    assert not is_old(page)


def test_an_older_gateway_is_shown_with_what_is_not_understood_of_it(
    context, tmp_path, short_folder, gateway
):
    def older(method: str, result: Any) -> Any:
        if method == "events":
            return None
        if method == "why":
            return {k: v for k, v in result.items() if k not in ("waits", "summary")}
        return result

    relay = AlteringRelay(short_folder / "older.sock", gateway.socket_path, older)
    with contextlib.closing(relay), serving(tmp_path, short_folder / "older.sock") as web:
        page, seen = opened(context, web.url)
        page.wait_for_selector("#notes:text('why.waits is missing')")
        page.wait_for_selector("#notes:text('events is null')")
        assert re.search(r"page is of version \S+, the gateway of \d", text(page, "#notes"))
        modes = ("starting;", "standby;", "active;", "fault;")
        assert text(page, ".sentence").startswith(modes), "no summary: the sentence itself"
        page.screenshot(path=PICTURES / "not-understood-1024.png")
        assert not is_old(page)
        assert {part for one in web.events("not_understood") for part in one["parts"]} == {
            "why.waits is missing",
            "events is null",
        }
        assert seen.errors == []


def test_events_of_gateway_and_page_are_found_by_typing(context, web):
    web.act("disarm")
    page, _ = opened(context, web.url, "events")
    page.wait_for_selector(".events .name:text('action_asked')")
    page.wait_for_selector(".events .name:text('mode_changed')")
    page.get_by_role("searchbox", name="Find an event").fill("mode_changed")
    names = set(page.locator(".events tbody .name").all_inner_texts())
    assert names == {"mode_changed"}
