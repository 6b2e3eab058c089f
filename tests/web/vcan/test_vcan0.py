"""The page in Chromium beside the real programs on a real vcan0; slow where that is in the lab."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.vcan.conftest import (
    COMMANDS,
    Stand,
    a_real_vcan0,  # noqa: F401 - a fixture
    ended_after,
    wait_until,
)
from tests.web.browser import PICTURES, WIDTHS, Seen, chromium, context_of
from tests.web.stand import serving
from vcu_gateway.client import Client, ClientError

VIEWS = ("why", "signals", "plots", "events", "bus", "recordings")
RECORDED = Path(__file__).parents[2] / "golden" / "drives" / "battery-codes"
PATIENCE_MS = 240_000
PATIENCE_S = PATIENCE_MS / 1000
POWER_CUT = 0x80

pytestmark = pytest.mark.timeout(1200)


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Stand]:
    with ended_after(Stand(tmp_path)) as one:
        yield one


def test_every_view_and_the_stop_beside_the_real_programs_on_vcan0(stand: Stand, tmp_path: Path):
    stand.vehicle()
    stand.gateway()
    recording = stand.record()
    client = Client(stand.socket_path, timeout_s=20)

    def answers() -> bool:
        try:
            return client.why()["mode"] == "standby"
        except ClientError:
            return False

    wait_until(answers, "standby", PATIENCE_S)
    recordings = tmp_path / "recordings"
    shutil.copytree(RECORDED, recordings / "drives" / "20261123T180412Z-1f3a9c2e")
    (recordings / "incidents").mkdir()
    options = ("--local-role", "service", "--recordings", str(recordings))
    with (
        serving(tmp_path, stand.socket_path, *options) as web,
        chromium(PATIENCE_MS) as browser,
        context_of(browser) as context,
    ):
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        seen = Seen(page)
        page.goto(web.url)
        page.wait_for_function("() => document.getElementById('mode').textContent.length > 1")
        PICTURES.mkdir(parents=True, exist_ok=True)
        for view in VIEWS:
            page.evaluate(f"location.hash = '#{view}'")
            page.wait_for_selector(f"#view-{view}:not([hidden])")
            if view == "recordings":
                page.wait_for_selector("text=1 recording")
            page.wait_for_timeout(1500)
            for width, height in WIDTHS.items():
                page.set_viewport_size({"width": width, "height": height})
                assert page.evaluate("document.documentElement.scrollWidth") <= width
                picture = PICTURES / f"vcan0-{view}-{width}.png"
                page.screenshot(path=picture, timeout=PATIENCE_MS)
            if view == "bus":
                assert re.search(r"socketcan\s+vcan0", page.inner_text("#view-bus"))
        assert seen.errors == []
        before = len(recording.commands())
        page.evaluate("document.getElementById('stop').click()")
        page.wait_for_selector("#stop-outcome[data-stage=cut]")
        after = recording.commands()[before:]
        cut = {frame.can_id for frame in after if frame.data[0] & POWER_CUT}
        assert cut == set(COMMANDS)
    assert client.why()["mode"] == "fault"
    client.close()
