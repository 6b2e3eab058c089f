"""The page of a simulated vehicle that drives: `python -m tests.web.screenshot FILE`."""

import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser

from tests.web.browser import chromium, context_of, opened
from tests.web.stand import GatewayProcess, gateway_running, serving

SECONDS = 12
DRIVES = 5


def draw(browser: Browser, gateway: GatewayProcess, folder: Path, file: Path) -> None:
    """A drive of some seconds, then the page; a busy machine may end a drive."""
    with (
        serving(folder, gateway.socket_path, "--local-role", "service") as web,
        context_of(browser, 1920) as context,
    ):
        page, _ = opened(context, web.url)
        page.set_viewport_size({"width": 1600, "height": 1330})
        for _ in range(DRIVES):
            gateway.ask("reset")
            gateway.ask("drive", 30.0)
            page.wait_for_timeout(SECONDS * 1000)
            page.screenshot(path=file)
            is_driving = gateway.ask("mode") == "active"
            gateway.ask("park")
            if is_driving:
                return
    raise SystemExit("error: the vehicle did not drive; is the machine busy?")


def main(file: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="vcu-web.") as name, chromium() as browser:
        folder = Path(name)
        with gateway_running(folder) as gateway:
            draw(browser, gateway, folder, file)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
