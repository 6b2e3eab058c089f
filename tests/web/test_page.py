"""The page in a real Chromium, beside a real gateway and a simulated vehicle."""

import os
import re
import signal
import subprocess
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.web.browser import PICTURES, WIDTHS, chromium, context_of, is_old, opened
from tests.web.conftest import PASSWORD
from tests.web.stand import GatewayProcess, gateway_running, proxied, serving

VIEWS = ("why", "signals", "plots", "events", "bus", "recordings")
OLD_WITHIN_S = 0.5

NOTE_OLD = """() => {
  window.marks = [];
  new MutationObserver(() => window.marks.push([
    'old' in document.documentElement.dataset, performance.timeOrigin + performance.now(),
    document.title, document.getElementById('old').textContent,
  ])).observe(document.documentElement, { attributes: true, attributeFilter: ['data-old'] });
}"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as one:
        yield one


@pytest.fixture
def web(tmp_path, gateway):
    with serving(tmp_path, gateway.socket_path, "--local-role", "service") as one:
        yield one


@pytest.fixture
def context(browser):
    with context_of(browser) as one:
        yield one


@pytest.fixture
def stopped(gateway):
    """Whatever a test stops can be driven again."""
    yield
    gateway.ask("park")
    gateway.ask("reset")


def text(page, selector: str) -> str:
    return page.inner_text(selector)


def until_old(page, old: bool) -> None:
    page.wait_for_function(
        f"() => ('old' in document.documentElement.dataset) === {str(old).lower()}"
    )


# What is shown.


@pytest.mark.parametrize("width", WIDTHS)
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


def test_why_is_the_largest_text_of_the_page(context, web):
    page, _ = opened(context, web.url)
    sizes = page.evaluate(
        "[...document.querySelectorAll('#view-why *')].map(one => "
        "[parseFloat(getComputedStyle(one).fontSize), one.className])"
    )
    assert max(sizes)[1] == "sentence"
    assert text(page, ".next span") not in text(page, ".sentence"), "it says nothing twice"


@pytest.mark.parametrize("colours", ["dark", "light"])
@pytest.mark.parametrize("width", [360, 1920])
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


def test_numbers_do_not_jump_while_the_vehicle_drives(gateway, context, web):
    gateway.ask("drive")
    page, _ = opened(context, web.url)
    page.wait_for_timeout(1500)
    moved = page.evaluate(
        """async () => {
          const values = [...document.querySelectorAll('#view-why td .v, #view-why .rows .n .v')];
          const edge = (one) => Math.round(one.getBoundingClientRect().right * 10);
          const first = values.map(edge);
          const moved = new Set();
          let texts = new Set();
          for (let i = 0; i < 60; i++) {
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


def test_each_value_greys_by_its_own_age_and_the_others_stay_live(gateway, context, web):
    page, _ = opened(context, web.url, "signals")
    gateway.ask("silence", "BMS_Temperatures")
    quality = "section[aria-label=BMS_Temperatures] .v[data-q=stale]"
    page.wait_for_selector(quality)
    assert page.locator("section[aria-label=IMU_Attitude] .v[data-q=live]").count() == 3
    assert not is_old(page)
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


def test_plots_of_signals_that_are_no_more_ask_for_nothing(context, web):
    context.add_init_script("localStorage.setItem('plots', '[\"Nothing.Here\"]')")
    page, seen = opened(context, web.url, "plots")
    page.wait_for_timeout(1000)
    assert [one for one in seen.addresses if "/api/history" in one] == []
    assert seen.errors == []


# Old is never shown as live.


def test_a_stalled_stream_is_old_within_half_a_second_and_comes_back(context, web):
    with proxied(web.port) as proxy:
        page, _ = opened(context, proxy.url)
        page.evaluate(NOTE_OLD)
        page.wait_for_timeout(1000)
        begin_s = proxy.stall()
        until_old(page, True)
        page.wait_for_timeout(100)
        old, at_ms, _, banner = page.evaluate("window.marks")[0]
        assert old
        assert at_ms / 1000 - begin_s < OLD_WITHIN_S
        assert re.match(r"OLD since \d\d:\d\d:\d\d", banner)
        assert page.title().startswith("OLD since ")
        assert text(page, "#pulse-text") == "not live"
        assert page.locator("#view-why .v[data-q=live]").count() == 0
        PICTURES.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=PICTURES / "old-1024.png")
        proxy.flow()
        until_old(page, False)
        assert page.title() == "vcu-gateway"


def test_what_waited_in_a_buffer_is_not_live_however_steadily_it_comes(context, web):
    with proxied(web.port) as proxy:
        page, _ = opened(context, proxy.url)
        page.wait_for_timeout(1000)
        proxy.delay_s = 1.5
        until_old(page, True)
        page.wait_for_timeout(2500)
        page.evaluate(NOTE_OLD)
        page.wait_for_timeout(3000)
        assert is_old(page)
        assert page.evaluate("window.marks") == []
        proxy.delay_s = 0.0
        until_old(page, False)


def test_a_stream_that_is_cut_is_taken_up_again(context, web):
    with proxied(web.port) as proxy:
        page, _ = opened(context, proxy.url)
        proxy.cut()
        until_old(page, True)
        until_old(page, False)


def test_a_gateway_that_is_killed_makes_everything_old_until_it_is_back(
    context, tmp_path, short_folder
):
    with serving(tmp_path, short_folder / "control.sock") as web:
        first = GatewayProcess(short_folder)
        page, _ = opened(context, web.url)
        first.kill()
        until_old(page, True)
        page.wait_for_function("() => /gateway/.test(document.getElementById('old').textContent)")
        with gateway_running(short_folder):
            until_old(page, False)
            assert text(page, "#mode") in ("starting", "standby", "fault")


def test_a_gateway_that_hangs_makes_everything_old_while_its_server_answers(gateway, context, web):
    page, _ = opened(context, web.url)
    os.kill(gateway.process.pid, signal.SIGSTOP)
    try:
        begin_s = time.monotonic()
        until_old(page, True)
        assert time.monotonic() - begin_s < 2
        page.wait_for_timeout(1500)
        assert is_old(page)
        assert page.title().startswith("OLD since ")
    finally:
        os.kill(gateway.process.pid, signal.SIGCONT)
    until_old(page, False)
    gateway.ask("reset")


def test_a_server_that_is_killed_and_started_again_is_found_again(context, tmp_path, gateway):
    with serving(tmp_path, gateway.socket_path) as web:
        page, _ = opened(context, web.url)
        web.end(signal.SIGKILL)
        until_old(page, True)
        with serving(tmp_path, gateway.socket_path, port=web.port):
            until_old(page, False)


def test_a_page_whose_thread_hung_shows_nothing_of_then(context, web):
    page, _ = opened(context, web.url)
    page.evaluate("() => { const end = Date.now() + 3000; while (Date.now() < end); }")
    age_ms = page.evaluate("import('/model.js').then((model) => model.stateAge())")
    page.wait_for_timeout(300)
    until_old(page, False)
    assert age_ms > 0


@pytest.mark.parametrize("by_ms", [-500_000, 500_000])
def test_a_server_whose_clock_began_anew_is_live_again_within_seconds(context, web, by_ms):
    def shifted(route) -> None:
        answer = route.fetch()
        value = answer.json()
        value.get("clock", value)["monotonic_ms"] += by_ms
        route.fulfill(response=answer, json=value)

    of_the_clock = re.compile("/api/(clock|session)$")
    context.route(of_the_clock, shifted)
    page = context.new_page()
    page.goto(web.url)
    page.wait_for_function("() => document.getElementById('mode').textContent.length > 1")
    page.wait_for_timeout(500)
    context.unroute(of_the_clock)
    page.wait_for_function(
        """() => import('/model.js').then((model) =>
          Math.abs(model.monotonicNow() - model.model.state.t) < 2000)""",
        timeout=8000,
    )
    until_old(page, False)


def test_eight_tabs_share_one_stream_and_outlive_the_one_that_has_it(context, web):
    tabs = [opened(context, web.url) for _ in range(8)]
    streams = [
        index
        for index, (_, seen) in enumerate(tabs)
        if any(address.endswith("/api/stream") for address in seen.addresses)
    ]
    assert streams == [0]
    assert not any(is_old(page) for page, _ in tabs)
    tabs[0][0].close()
    page = tabs[5][0]
    page.wait_for_timeout(1500)
    until_old(page, False)
    assert "Recordings" in text(page, "#views")


# Acting.


LIVE_REASONS = """() => {
  window.reasons = [];
  const panel = document.querySelector('.why'), mode = document.getElementById('mode');
  const look = () => {
    const live = panel.dataset.old === undefined;
    const reason = panel.querySelector('.sentence').textContent.split(';')[0];
    window.reasons.push([mode.textContent, live ? reason : 'old']);
    requestAnimationFrame(look);
  };
  look();
}"""


@pytest.mark.usefixtures("stopped")
def test_a_reason_of_another_mode_is_never_shown_as_live_and_the_next_one_comes_soon(
    gateway, context, web
):
    gateway.ask("drive")
    page, _ = opened(context, web.url)
    page.wait_for_selector("#mode[data-mode=active]")
    page.wait_for_selector(".why:not([data-old])")
    page.evaluate(LIVE_REASONS)
    page.wait_for_timeout(300)
    page.click("#stop")
    page.wait_for_selector("#mode[data-mode=fault]")
    page.wait_for_selector(".why:not([data-old])")
    seen = page.evaluate("window.reasons")
    assert {mode: {two for one, two in seen if one == mode} - {"old"} for mode, _ in seen} == {
        "active": {"active"},
        "fault": {"fault"},
    }


@pytest.mark.usefixtures("stopped")
def test_an_emergency_stop_says_sent_and_then_confirmed_with_the_bytes(gateway, context, web):
    gateway.ask("drive")
    page, seen = opened(context, web.url)
    page.wait_for_selector("#mode[data-mode=active]")
    page.click("#stop")
    page.wait_for_selector("#stop-outcome[data-state=confirmed]")
    said = text(page, "#stop-outcome")
    assert "CONFIRMED: power is cut" in said
    assert re.search(r"SENT \d\d:\d\d:\d\d\.\d{3} → CONFIRMED after \d+ ms, mode fault", said)
    assert "0008A7D0#8C" in said
    assert set(gateway.ask("cuts")) == {"PCU1", "PCU2"}
    page.wait_for_selector("#cut:not([hidden])")
    page.screenshot(path=PICTURES / "stopped-1024.png")
    gateway.ask("park")
    assert seen.errors == []


def test_a_stop_that_nobody_answers_says_to_use_the_contactor_and_goes_on(gateway, context, web):
    page, _ = opened(context, web.url)
    os.kill(gateway.process.pid, signal.SIGSTOP)
    try:
        begin_s = time.monotonic()
        page.click("#stop")
        page.wait_for_selector("#stop-outcome[data-state=failed]")
        assert time.monotonic() - begin_s < 1.5
        assert "NOT CONFIRMED: use the contactor" in text(page, "#stop-outcome")
        assert is_old(page)
        page.screenshot(path=PICTURES / "not-confirmed-1024.png")
    finally:
        os.kill(gateway.process.pid, signal.SIGCONT)
    page.wait_for_selector("#stop-outcome[data-state=confirmed]")
    gateway.ask("reset")


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
        page.fill("#sign-in-password", PASSWORD)
        page.press("#sign-in-password", "Enter")
        page.wait_for_selector("#pulse[data-live=yes]")
        page.wait_for_selector("#sign-in[open]", timeout=30_000)
        assert "The session has ended" in text(page, "#sign-in-why")
        until_old(page, True)
        page.click("#stop")
        page.wait_for_selector("#stop-outcome[data-state=confirmed]")


def test_arming_takes_a_whole_second_and_shows_the_gateways_sentence(gateway, context, web):
    page, _ = opened(context, web.url)
    page.wait_for_selector("#arm:enabled")
    page.locator("#arm").click(delay=400)
    page.wait_for_timeout(900)
    assert web.events("action_asked") == []
    page.locator("#arm").focus()
    page.keyboard.down("Space")
    page.wait_for_selector("#said[data-kind=refused]")
    page.keyboard.up("Space")
    assert "demand" in text(page, "#said")


def test_who_has_the_pedals_drives_and_the_page_arms_and_disarms(gateway, context, web):
    gateway.ask("demand_nothing")
    page, _ = opened(context, web.url)
    page.wait_for_selector("#arm:enabled")
    box = page.locator("#arm").bounding_box()
    page.mouse.move(box["x"] + 20, box["y"] + 20)
    page.mouse.down()
    page.wait_for_selector("#mode[data-mode=active]")
    page.mouse.up()
    page.click("#disarm")
    page.wait_for_selector("#mode[data-mode=standby]")
    gateway.ask("park")


def test_a_reset_shows_its_reason_before_it_is_asked_for(gateway, context, web):
    page, _ = opened(context, web.url)
    page.click("#stop")
    page.wait_for_selector("#stop-outcome[data-state=confirmed]")
    page.wait_for_selector("#reset:enabled")
    page.wait_for_timeout(1200)
    page.click("#reset")
    assert "Latched: " in text(page, "#reset-reason")
    assert "service level" in text(page, "#reset-level")
    page.screenshot(path=PICTURES / "reset-1024.png")
    page.click("#stop")  # still in reach
    page.wait_for_selector("#stop-outcome[data-state=confirmed]")
    page.keyboard.press("Escape")
    page.locator("#reset").click()
    page.click("#reset-leave")
    assert not page.is_visible("#reset-dialog")
    assert gateway.ask("mode") == "fault"
    gateway.ask("reset")
    page.wait_for_selector("#stop-outcome", state="hidden")


def test_everything_is_reached_by_the_keyboard(context, web):
    page, _ = opened(context, web.url)
    reached = []
    for _ in range(20):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.hash"))
    assert "#signals" in reached
    assert "stop" in reached
    assert "disarm" in reached


# Other sites.

FOREIGN = b"""<!doctype html><title>foreign</title><script>
const port = location.hash.slice(1), url = `http://127.0.0.1:${port}`;
window.results = {};
(async () => {
  const attempt = async (name, options) => {
    try { const a = await fetch(url + name, options); results[name] = a.type + a.status; }
    catch (error) { results[name] = 'failed'; }
  };
  await attempt('/api/actions/estop', {method: 'POST', mode: 'no-cors', credentials: 'include'});
  await attempt('/api/clock', {credentials: 'include'});
  const frame = document.createElement('iframe');
  frame.src = url + '/';
  document.body.append(frame);
  const source = new EventSource(url + '/api/stream');
  source.onmessage = source.onopen = () => { results.stream = 'open'; };
  source.onerror = () => { results.stream ??= 'failed'; };
  setTimeout(() => { results.done = true; }, 1500);
})();
</script><body></body>"""


class ForeignSite(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(FOREIGN)

    def log_message(self, *arguments: object) -> None:
        pass


def test_a_page_of_another_site_neither_reads_nor_stops(gateway, context, web):
    server = HTTPServer(("127.0.0.1", 0), ForeignSite)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    page = context.new_page()
    page.goto(f"http://localhost:{server.server_address[1]}/#{web.port}")
    page.wait_for_function("() => window.results?.done")
    results = page.evaluate("window.results")
    server.shutdown()
    assert results["/api/clock"] == "failed"
    assert results["stream"] == "failed"
    assert web.events("action_asked") == []
    assert gateway.ask("mode") != "fault"
    frames = [frame for frame in page.frames if frame != page.main_frame]
    assert not any(frame.query_selector("#stop") for frame in frames), "no frame shows it"


# Events.


def test_events_of_gateway_and_page_are_found_by_typing(context, web):
    web.act("disarm")
    page, _ = opened(context, web.url, "events")
    page.wait_for_selector(".events .name:text('action_asked')")
    page.wait_for_selector(".events .name:text('mode_changed')")
    page.get_by_role("searchbox", name="Find an event").fill("mode_changed")
    names = set(page.locator(".events tbody .name").all_inner_texts())
    assert names == {"mode_changed"}
