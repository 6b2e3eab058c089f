"""Arming, disarming and resetting from the page, in a real Chromium; no other site can."""

import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from tests.web.browser import PICTURES, opened, text, until_driving

LIVE_REASONS = """() => {
  window.reasons = [];
  const panel = document.querySelector('.why'), mode = document.getElementById('mode');
  const look = () => {
    const live = panel.dataset.old === undefined;
    const line = panel.querySelector('.why-line');
    const told = line.hidden ? panel.querySelector('.sentence') : line;
    const reason = told.textContent.split(';')[0];
    window.reasons.push([mode.textContent, live ? reason : 'old']);
    requestAnimationFrame(look);
  };
  look();
}"""

LIVE_IN_FAULT_WAS_SEEN = """() =>
  window.reasons.some(([mode, told]) => mode === 'fault' && told !== 'old')"""


@pytest.mark.usefixtures("stopped")
def test_a_reason_of_another_mode_is_never_shown_as_live_and_the_next_one_comes_soon(
    gateway, context, web
):
    page, _ = opened(context, web.url)
    until_driving(gateway, page)
    page.wait_for_selector(".why:not([data-old])")
    page.evaluate(LIVE_REASONS)
    page.wait_for_timeout(300)
    page.click("#stop")
    page.wait_for_function(LIVE_IN_FAULT_WAS_SEEN)
    seen = page.evaluate("window.reasons")
    modes = {mode for mode, _ in seen}
    assert modes >= {"active", "fault"}
    told = {mode: {two for one, two in seen if one == mode} - {"old"} for mode in modes}
    assert told == {mode: {mode} for mode in modes}


@pytest.mark.clock
def test_arming_takes_a_whole_second_and_shows_the_gateways_sentence(gateway, context, web):
    page, _ = opened(context, web.url)
    page.wait_for_selector("#arm:enabled")
    before = web.events("action_asked")
    page.locator("#arm").click(delay=400)
    page.wait_for_timeout(900)
    assert web.events("action_asked") == before
    page.locator("#arm").focus()
    page.keyboard.down("Space")
    page.wait_for_selector("#said[data-kind=refused]")
    page.keyboard.up("Space")
    assert "demand" in text(page, "#said")


@pytest.mark.clock
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
    page.wait_for_selector("#stop-outcome[data-stage=cut]")
    page.wait_for_selector("#reset:enabled")
    page.wait_for_timeout(1200)
    page.click("#reset")
    assert "Latched: " in text(page, "#reset-reason")
    assert "service level" in text(page, "#reset-level")
    page.screenshot(path=PICTURES / "reset-1024.png")
    page.click("#stop")  # still in reach
    page.wait_for_selector("#stop-outcome[data-stage=cut]")
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
    before = web.events("action_asked")
    page = context.new_page()
    page.goto(f"http://localhost:{server.server_address[1]}/#{web.port}")
    page.wait_for_function("() => window.results?.done")
    results = page.evaluate("window.results")
    server.shutdown()
    assert results["/api/clock"] == "failed"
    assert results["stream"] == "failed"
    assert web.events("action_asked") == before
    assert gateway.ask("mode") != "fault"
    frames = [frame for frame in page.frames if frame != page.main_frame]
    assert not any(frame.query_selector("#stop") for frame in frames), "no frame shows it"
