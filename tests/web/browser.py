"""Debian's Chromium, driven by Playwright; what it said and asked for is kept with each page."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Page,
    Playwright,
    ViewportSize,
    sync_playwright,
)
from playwright.sync_api import (
    TimeoutError as PlaywrightTimeout,
)

from tests.browser import no_browser
from tests.web.stand import GatewayProcess

PROGRAMS = ("chromium", "chromium-headless-shell", "google-chrome")
PICTURES = Path(__file__).parents[2] / "build" / "web"
WIDTHS = {360: 740, 1024: 768, 1920: 1080}


def program() -> str:
    """Path of the browser; without one the test fails (but on Ubuntu)."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None) or no_browser()


@contextlib.contextmanager
def chromium(patience_ms: float = 60_000) -> Iterator[Browser]:
    """The browser, ended with everything that it started."""
    path = program()
    sandbox = [] if os.geteuid() else ["--no-sandbox"]
    with sync_playwright() as playwright:
        browser = launched(playwright, path, sandbox, patience_ms)
        try:
            yield browser
        finally:
            browser.close()


def launched(playwright: Playwright, path: str, options: list[str], patience_ms: float) -> Browser:
    """Without a shared memory folder too, as in a container."""
    args = [*options, "--disable-dev-shm-usage", "--disable-gpu"]
    return playwright.chromium.launch(executable_path=path, args=args, timeout=patience_ms)


class Seen:
    """What a page said on its console, and the addresses that it asked for."""

    def __init__(self, page: Page) -> None:
        self.errors: list[str] = []
        self.addresses: list[str] = []
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.addresses.append(request.url))

    def _on_console(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            self.errors.append(f"{message.text} {message.location}")


@contextlib.contextmanager
def context_of(browser: Browser, width: int = 1024) -> Iterator[BrowserContext]:
    """A browser of its own: other cookies, other storage."""
    size: ViewportSize = {"width": width, "height": WIDTHS[width]}
    context = browser.new_context(viewport=size, color_scheme="dark")
    context.set_default_timeout(20_000)
    try:
        yield context
    finally:
        context.close()


def opened(context: BrowserContext, url: str, view: str = "why") -> tuple[Page, Seen]:
    """The page with live values in it."""
    page = context.new_page()
    seen = Seen(page)
    page.goto(f"{url}#{view}")
    page.wait_for_selector("#pulse[data-live=yes]")
    return page, seen


def is_old(page: Page) -> bool:
    return bool(page.evaluate("'old' in document.documentElement.dataset"))


def text(page: Page, selector: str) -> str:
    return page.inner_text(selector)


def until_old(page: Page, old: bool) -> None:
    page.wait_for_function(
        f"() => ('old' in document.documentElement.dataset) === {str(old).lower()}"
    )


def until_driving(gateway: GatewayProcess, page: Page) -> None:
    """Active in the page; a drive that the machine ended, for it stood still, is begun again."""
    for _ in range(10):
        gateway.ask("drive")
        with contextlib.suppress(PlaywrightTimeout):
            page.wait_for_selector("#mode[data-mode=active]", timeout=3000)
            return
    raise AssertionError("the page never shows a drive")
