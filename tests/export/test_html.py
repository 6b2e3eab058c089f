"""The HTML page in a real Chromium: no request, no complaint, and what a person does with it."""

import os
import re
from pathlib import Path

import pytest

from tests.browser import Chromium, Page, chromium
from tests.export.drives import record
from tests.export.logs import random_frames, write_log
from vcu_gateway.export import html_report
from vcu_gateway.export.formats import written_text
from vcu_gateway.export.html_report import write_report
from vcu_gateway.export.report import CodeLine, Line, LineBuilder, Overlay, Plot, Report, Role
from vcu_gateway.text import TIME_OF_DAY_MS, utc
from vcu_gateway.units import NS_PER_MS

__all__ = ["chromium"]
pytestmark = pytest.mark.timeout(300)

LIMIT_BYTES = 2_000_000


def written(name: Path, path: Path, overlay: Overlay | None = None) -> Path:
    with written_text(path) as out:
        write_report(str(name), out, overlay)
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("drives") / "drive")


def what_if(recorded) -> Overlay:
    """The same drive with half of the throttle, and a fault two seconds earlier."""
    first_ns = first_tick_ns(recorded)
    times_ns = [first_ns + number * 50 * NS_PER_MS for number in range(len(recorded.results))]
    halves = [frame.data[1] // 2 * 0.39 for one in recorded.results for frame in one.frames[:1]]
    times_ns = times_ns[-len(halves) :]
    return Overlay(
        "Would have stopped 2 s earlier",
        ("Open loop: the recorded vehicle does not react.",),
        ("field", "ticks"),
        (("throttle", "<script>alert(1)</script>"),),
        times_ns,
        {"VCU_PCU1_Command.Throttle": halves},
        [(times_ns[0], "standby"), (times_ns[-100], "fault")],
        [("BMS_Status.CellUndervoltage: stop", times_ns[-100], None)],
    )


def first_tick_ns(recorded) -> int:
    """Wall time of the first tick."""
    last_ns = recorded.now_ns + recorded.writer._distance_ns
    return last_ns - (len(recorded.results) - 1) * 50 * NS_PER_MS


@pytest.fixture(scope="module")
def pages(recorded, tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    log = write_log(folder / "foreign.log", random_frames(6000))
    drive = recorded.writer.folder
    return {
        "drive": written(drive, folder / "drive.html"),
        "what if": written(drive, folder / "what-if.html", what_if(recorded)),
        "log": written(log, folder / "log.html"),
    }


@pytest.fixture
def page(chromium: Chromium) -> Page:
    return chromium.page()


def seen(page: Page, path: Path, **view) -> Page:
    page.open(path, **view)
    return page


@pytest.mark.parametrize("kind", ["drive", "what if", "log"])
@pytest.mark.parametrize(
    ("width", "height", "dark"), [(1440, 1000, False), (1440, 1000, True), (360, 740, False)]
)
def test_it_opens_without_a_request_or_a_complaint(
    page, pages, kind, width, height, dark, tmp_path
):
    seen(page, pages[kind], width=width, height=height, dark=dark)
    page.until("document.querySelectorAll('canvas').length > 2")
    assert set(page.requests) == {pages[kind].absolute().as_uri()}
    assert page.complaints == []
    assert page.value("document.documentElement.scrollWidth") <= width
    picture = tmp_path / "page.png"
    page.picture(picture)
    assert picture.stat().st_size > 20_000
    if folder := os.environ.get("VCU_PICTURES"):
        name = f"{kind.replace(' ', '-')}-{width}-{'dark' if dark else 'light'}.png"
        Path(folder, name).write_bytes(picture.read_bytes())


def test_its_policy_lets_nothing_in(pages):
    text = pages["drive"].read_text()
    [policy] = re.findall(r'Content-Security-Policy" content="([^"]+)"', text)
    digest = r"'sha256-[\w+/]{43}='"
    assert re.fullmatch(
        rf"default-src 'none'; script-src {digest} {digest} {digest}; style-src {digest};"
        r" base-uri 'none'; form-action 'none'",
        policy,
    )
    assert not re.search(r'(?:src|href)\s*=\s*["\']?(?:https?:)?//', text)


def test_the_policy_is_obeyed_where_a_script_wants_more(page, pages, tmp_path):
    text = pages["drive"].read_text()
    path = tmp_path / "changed.html"
    path.write_text(text.replace("</body>", "<script>window.changed = 1</script></body>"))
    seen(page, path)
    assert page.value("window.changed") is None
    assert page.complaints


def test_the_headline_says_what_happened(page, pages):
    seen(page, pages["drive"])
    headline = page.value("document.querySelector('h1').textContent")
    assert re.fullmatch(
        r"1[45]\.\d s recorded, \d\.\d s of it active \(once\)\. A fault latched at"
        r" 17:46:\d\d\.\d{3}: BMS_Status\.CellUndervoltage 2 \(level2\): stop\.",
        headline,
    )


def test_a_log_without_decisions_says_so(page, pages):
    seen(page, pages["log"])
    assert "no decisions of a gateway" in page.value("document.querySelector('h1').textContent")


def range_of(page: Page) -> str:
    return page.value("document.querySelector('.range').textContent")


def test_an_event_leads_to_its_place_in_the_plots(page, pages):
    seen(page, pages["drive"])
    before = range_of(page)
    page.value(
        "[...document.querySelectorAll('.events li button')]"
        ".find(one => one.textContent.includes('fault latched')).click()"
    )
    assert range_of(page) != before
    assert page.value("document.querySelector('.why').textContent").endswith("then reset")
    assert "17:46:" in page.value("document.querySelector('[aria-current]').textContent")


def test_keys_zoom_move_and_go_from_event_to_event(page, pages):
    seen(page, pages["drive"])
    whole = range_of(page)
    page.press("+")
    closer = range_of(page)
    page.press("ArrowRight")
    later = range_of(page)
    page.press("0")
    assert range_of(page) == whole
    assert len({whole, closer, later}) == 3
    page.press("n")
    page.press("n")
    assert page.value("document.querySelectorAll('[aria-current]').length") == 1


def test_the_chosen_event_is_in_view(page, pages):
    seen(page, pages["drive"], height=480)
    page.value("scrollTo(0, 400)")
    for _ in range(20):
        page.press("n")
        top, bottom, height = page.value(
            "(box => [box.top, box.bottom, innerHeight])"
            "(document.querySelector('[aria-current]').getBoundingClientRect())"
        )
        assert 0 <= top < bottom <= height


def test_dragging_zooms_every_plot(page, pages):
    seen(page, pages["drive"])
    page.until("document.querySelectorAll('.u-over').length > 1")
    x, y, width = page.value(
        "(box => [box.x, box.y, box.width])"
        "(document.querySelectorAll('.u-over')[1].getBoundingClientRect())"
    )
    before = range_of(page)
    page.mouse((x + width * 0.25, y + 40), (x + width * 0.5, y + 40), (x + width * 0.75, y + 40))
    page.until(f"document.querySelector('.range').textContent !== {before!r}")


def test_the_legend_says_what_was_sent_at_the_cursor(page, pages, recorded):
    seen(page, pages["drive"])
    page.until("document.querySelectorAll('.u-over').length > 1")
    x, y, width = page.value(
        "(box => [box.x, box.y, box.width])"
        "(document.querySelectorAll('.u-over')[1].getBoundingClientRect())"
    )
    assert page.value("document.querySelector('.card h3').textContent") == "PCU1 throttle%"
    for part in (0.3, 0.4, 0.5):
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + width * part, y=y + 50)
        moment = page.value("document.querySelector('.why time').textContent")
        legend = page.value("document.querySelector('.legend').textContent")
        said = float(re.search(r"commanded([\d.]+)", legend)[1])
        tick = (seconds(moment) - seconds(utc(first_tick_ns(recorded), TIME_OF_DAY_MS))) / 0.05
        near = recorded.results[round(tick) - 2 : round(tick) + 3]
        sent = [one.frames[0].data[1] * 0.39 for one in near]
        assert min(abs(said - one) for one in sent) < 1e-9
    assert said > 0


def seconds(clock: str) -> float:
    hours, minutes, rest = clock.split(":")
    return int(hours) * 3600 + int(minutes) * 60 + float(rest)


def test_events_are_filtered(page, pages):
    seen(page, pages["drive"])
    rows = "document.querySelectorAll('.events li').length"
    every = page.value(rows)
    page.value(
        "(one => { one.value = 'fault latched'; one.dispatchEvent(new Event('input')); })"
        "(document.querySelector('.filter input'))"
    )
    assert page.value(rows) == 1 < every


def test_a_what_if_is_laid_over_and_its_text_is_no_markup(page, pages):
    seen(page, pages["what if"])
    assert (
        page.value("document.querySelector('h2').textContent") == "Would have stopped 2 s earlier"
    )
    assert page.value("document.querySelectorAll('.whatif script').length") == 0
    assert "what if" in page.value("document.querySelectorAll('.legend')[0].textContent")


def hour(noise: int) -> Report:
    """An hour of 40 lines at 20 Hz."""
    buckets = 36_000
    bucket_ns = 100 * NS_PER_MS
    lines: list[CodeLine] = []
    state = 12345
    for _ in range(40):
        builder = LineBuilder(buckets)
        codes = []
        for _ in range(2 * buckets):
            state = (state * 1_103_515_245 + 12_345) % (1 << 31)
            codes.append((state >> 16) % noise)
        builder.add([number // 2 for number in range(2 * buckets)], codes)
        lines.append(builder.line(0))
    plots = tuple(Plot("noise", "V", (Line("noise", Role.SIGNAL, line),)) for line in lines)
    end_ns = buckets * bucket_ns
    return Report(
        *("hour", "An hour", (), 0, end_ns, bucket_ns, buckets, plots, (), (), (), (), {}, None)
    )


@pytest.mark.parametrize(
    "noise",
    [pytest.param(2, marks=pytest.mark.ci), pytest.param(1000, marks=pytest.mark.ci), 32768],
)
def test_an_hour_is_at_most_2_mb_however_noisy(noise):
    assert len(html_report.page(hour(noise)).encode()) <= LIMIT_BYTES


@pytest.mark.ci
def test_a_very_noisy_hour_is_still_drawn(page, tmp_path):
    path = tmp_path / "hour.html"
    path.write_text(html_report.page(hour(32768)))
    seen(page, path)
    page.until("document.querySelectorAll('canvas').length > 2")
    assert page.complaints == []
    assert range_of(page) == "0 s – 3600 s · 1 h 0 min"
