"""What the page costs and how fast it is, in one run; build/web/figures.json has the figures."""

import contextlib
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import pytest

from tests.faults.pure.bystander import once_more
from tests.web.browser import PICTURES, chromium, context_of, opened
from tests.web.stand import ROOT, GatewayProcess, WebProcess, serving

PAINTED = """() => {
  window.painted = [];
  const cell = [...document.querySelectorAll('.wheels .name')]
    .find((one) => one.textContent === 'Steering').nextElementSibling.nextElementSibling;
  new MutationObserver(() => {
    const text = cell.textContent;
    // The frame after the next one has been drawn with it.
    requestAnimationFrame(() => requestAnimationFrame((now) =>
      window.painted.push([text, performance.timeOrigin + now])));
  }).observe(cell, {subtree: true, characterData: true, childList: true});
}"""

pytestmark = pytest.mark.slow  # on a machine that does little else

LOOKERS = 20
WINDOW_S = 8.0
ROUNDS = 4


@pytest.fixture(scope="module")
def figures() -> Iterator[dict[str, object]]:
    found: dict[str, object] = {}
    yield found
    PICTURES.mkdir(parents=True, exist_ok=True)
    (PICTURES / "figures.json").write_text(json.dumps(found, indent=2) + "\n")
    print(json.dumps(found, indent=2))


@pytest.fixture
def web(tmp_path, gateway):
    with serving(tmp_path, gateway.socket_path, "--local-role", "service") as one:
        yield one


@pytest.fixture
def page(web):
    with chromium() as browser, context_of(browser) as context:
        page, _ = opened(context, web.url)
        page.wait_for_timeout(1000)
        yield page


def percentile(values: list[float], share: float) -> float:
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def told(delays_ms: list[float], share: float) -> dict[str, float]:
    return {
        "values": len(delays_ms),
        "p50": round(statistics.median(delays_ms), 1),
        f"p{share * 100:.0f}": round(percentile(delays_ms, share), 1),
    }


def test_a_value_on_the_bus_is_a_pixel_within_150_ms(gateway, page, figures):
    page.evaluate(PAINTED)

    def delays_ms() -> list[float]:
        page.evaluate("window.painted = []")
        gateway.begin("steer", 200)
        page.wait_for_timeout(200 * 115)
        sent = gateway.answer()
        page.wait_for_timeout(500)
        painted: dict[str, float] = {}
        for text, at_ms in page.evaluate("window.painted"):
            painted.setdefault(text.split()[0].replace("−", "-").removesuffix("°"), at_ms)
        gateway.ask("reset")
        return [
            painted[shown] - at_s * 1000
            for at_s, angle in sent
            if (shown := f"{angle + 0:.2f}") in painted
        ]

    taken = once_more(delays_ms, lambda one: len(one) > 150 and percentile(one, 0.95) <= 150)
    figures["bus_to_pixel_ms"] = [told(one, 0.95) for one in taken]


def test_a_click_cuts_the_power_on_the_bus_within_150_ms(gateway, page, figures):
    def delay_ms() -> float:
        gateway.ask("reset")
        page.wait_for_selector("#stop-outcome", state="hidden")
        page.wait_for_selector("#mode[data-mode=standby]")
        clicked_ms: float = page.evaluate(
            "() => { const at = performance.timeOrigin + performance.now();"
            " document.getElementById('stop').click(); return at; }"
        )
        page.wait_for_selector("#stop-outcome[data-stage=cut]")
        cuts = gateway.ask("cuts")
        return max(cuts.values()) * 1000 - clicked_ms

    taken = once_more(
        lambda: [delay_ms() for _ in range(40)], lambda one: percentile(one, 0.99) <= 150
    )
    gateway.ask("reset")
    figures["click_to_power_cut_ms"] = [told(one, 0.99) for one in taken]


@contextlib.contextmanager
def looking(web: WebProcess, count: int) -> Iterator[None]:
    """So many browsers that read the stream."""
    command = [sys.executable, "-m", "tests.web.lookers", str(web.port), str(count)]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=ROOT)
    assert process.stdin is not None
    assert process.stdout is not None
    with process:
        assert process.stdout.readline() == "looking\n"
        yield
        process.stdin.close()


def processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1000


def p99_ratio(with_us: Sequence[list[float]], without_us: Sequence[list[float]]) -> float:
    """Of the ticks of all windows together."""
    with_all, without_all = (list(chain.from_iterable(one)) for one in (with_us, without_us))
    return percentile(with_all, 0.99) / percentile(without_all, 0.99)


def interval(with_us: Sequence[list[float]], without_us: Sequence[list[float]]) -> list[float]:
    """Where that ratio would be, nine times in ten, with other windows of the same machine."""
    chance = random.Random(1)
    ratios = [
        p99_ratio(*(chance.choices(one, k=len(one)) for one in (with_us, without_us)))
        for _ in range(400)
    ]
    return [percentile(ratios, 0.05), percentile(ratios, 0.95)]


@pytest.mark.timeout(600)
def test_twenty_browsers_cost_little_and_no_tick_notices(gateway: GatewayProcess, web, figures):
    windows_us: dict[int, list[list[float]]] = {0: [], LOOKERS: []}
    shares = []
    for count in (0, LOOKERS, LOOKERS, 0) * ROUNDS:
        with looking(web, count):
            time.sleep(1)
            gateway.ask("lateness_us")
            begin_s, used_s = time.monotonic(), processor_s(web.process.pid)
            time.sleep(WINDOW_S)
            windows_us[count].append(gateway.ask("lateness_us"))
            if count:
                taken_s = processor_s(web.process.pid) - used_s
                shares.append(taken_s / (time.monotonic() - begin_s))
                memory_mb = resident_mb(web.process.pid)
    low, high = interval(windows_us[LOOKERS], windows_us[0])
    figures["twenty_browsers"] = {
        "share_of_a_core": round(statistics.mean(shares), 3),
        "resident_mb": round(memory_mb, 1),
        "tick_lateness_us": {
            count: {
                name: round(percentile(list(chain.from_iterable(windows)), share))
                for name, share in (("p50", 0.5), ("p99", 0.99))
            }
            for count, windows in windows_us.items()
        },
        "p99_ratio": round(p99_ratio(windows_us[LOOKERS], windows_us[0]), 3),
        "interval": [round(low, 3), round(high, 3)],
        "ticks": {count: sum(map(len, windows)) for count, windows in windows_us.items()},
    }
    assert memory_mb <= 60
    assert statistics.mean(shares) <= 0.05
    # The worst hundredth of some minutes is a matter of luck: certainly more is a failure.
    assert low <= 1.05


def test_a_server_that_is_killed_while_driving_costs_no_tick(gateway, tmp_path, figures):
    gateway.ask("drive")

    def killed() -> dict[str, int]:
        with (
            serving(tmp_path, gateway.socket_path, "--local-role", "service") as web,
            looking(web, LOOKERS),
        ):
            time.sleep(2)
            before = gateway.ask("ticks")
            web.end(signal.SIGKILL)
            time.sleep(3)
            after = gateway.ask("ticks")
        return {name: after[name] - before[name] for name in ("done", "skipped")}

    taken = once_more(killed, lambda one: one["skipped"] == 0)
    assert gateway.ask("mode") == "active"
    gateway.ask("park")
    gateway.ask("reset")
    figures["ticks_around_a_kill"] = taken


def test_what_the_page_weighs_on_the_wire(web, figures):
    with chromium() as browser, context_of(browser) as context:
        page = context.new_page()
        session = context.new_cdp_session(page)
        session.send("Network.enable")
        received: dict[str, int] = {}
        urls: dict[str, str] = {}
        session.on(
            "Network.responseReceived",
            lambda event: urls.update({event["requestId"]: event["response"]["url"]}),
        )
        session.on(
            "Network.loadingFinished",
            lambda event: received.update({event["requestId"]: event["encodedDataLength"]}),
        )
        page.goto(web.url)
        page.wait_for_selector("#pulse[data-live=yes]")
        page.wait_for_timeout(500)
    total = sum(received.values())
    figures["page_bytes"] = int(total)
    assert len(urls) > 15
    assert total <= 150_000
