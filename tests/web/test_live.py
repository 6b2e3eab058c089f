"""What the page shows is live or said to be old, in a real Chromium."""

import os
import re
import signal
import time

import pytest

from tests.web.browser import PICTURES, is_old, opened, text, until_old
from tests.web.stand import GatewayProcess, gateway_running, proxied, serving

OLD_WITHIN_S = 0.5
FRAMES_AGE = r"() => /^Sent \d+(\.\d+)? s ago/.test(document.querySelector('.frames').textContent)"

NOTE_OLD = """() => {
  window.marks = [];
  new MutationObserver(() => window.marks.push([
    'old' in document.documentElement.dataset, performance.timeOrigin + performance.now(),
    document.title, document.getElementById('old').textContent,
  ])).observe(document.documentElement, { attributes: true, attributeFilter: ['data-old'] });
}"""


@pytest.mark.clock
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


@pytest.mark.ci
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


@pytest.mark.ci
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


@pytest.mark.clock
def test_a_gateway_that_hangs_makes_everything_old_while_its_server_answers(gateway, context, web):
    page, _ = opened(context, web.url)
    os.kill(gateway.process.pid, signal.SIGSTOP)
    try:
        begin_s = time.monotonic()
        until_old(page, True)
        assert time.monotonic() - begin_s < 2
        page.wait_for_timeout(1500)
        page.wait_for_function(FRAMES_AGE)
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


@pytest.mark.clock
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


@pytest.mark.ci
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
