"""Headless Chromium, spoken to over its debugging pipe: no port, no driver, no further package."""

import base64
import contextlib
import json
import os
import platform
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest

PATIENCE_S = 60
_NAMES = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"),
    *("--no-first-run", "--disable-extensions", "--disable-background-networking"),
    *("--remote-debugging-pipe", "--hide-scrollbars"),
)


class Page:
    """One open page.

    Attributes:
        requests: every address that it asked for.
        complaints: errors and warnings of its console, exceptions, and what its policy refused.
    """

    def __init__(self, browser: "Chromium", session: str) -> None:
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._browser, self._session = browser, session
        browser.listeners[session] = self._heard
        for domain in ("Page", "Runtime", "Network", "Log", "Audits"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **values: Any) -> dict[str, Any]:
        return self._browser.call(method, self._session, **values)

    def _heard(self, method: str, values: dict[str, Any]) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(values["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(str(values["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and values["type"] in ("error", "warning"):
            self.complaints.append(str(values["args"]))
        elif method == "Log.entryAdded":
            self.complaints.append(str(values["entry"]["text"]))

    def open(
        self, path: Path, width: int = 1440, height: int = 1000, *, dark: bool = False
    ) -> None:
        """Open a file of this machine and wait until it says that it is ready."""
        self.call(
            *("Emulation.setDeviceMetricsOverride",),
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=path.absolute().as_uri())
        self.until("document.body && document.body.dataset.ready === 'true'")

    def value(self, expression: str) -> Any:
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, expression: str) -> None:
        began_s = time.monotonic()
        while not self.value(expression):
            assert time.monotonic() - began_s < PATIENCE_S, (expression, self.complaints)
            time.sleep(0.05)

    def press(self, key: str) -> None:
        text = key if len(key) == 1 else ""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, text=text)

    def mouse(self, *points: tuple[float, float]) -> None:
        """Press at the first point, move over the others, and release at the last."""
        for index, (x, y) in enumerate(points):
            kind = "mousePressed" if index == 0 else "mouseMoved"
            held = {"button": "left", "buttons": 1, "clickCount": 1}
            if index == 0:
                self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **held)
        x, y = points[-1]
        self.call(
            "Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1
        )

    def picture(self, path: Path, *, whole: bool = False) -> None:
        taken = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(taken["data"]))


class Chromium:
    """A browser of its own with an empty profile."""

    def __init__(self, program: str, folder: Path) -> None:
        self.listeners: dict[str, Any] = {}
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        # The browser takes its commands from descriptor 3 and answers on 4.
        script = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        command = ["bash", "-c", script, "-", program, *_FLAGS, f"--user-data-dir={folder}"]
        self._process = subprocess.Popen(
            [*command, "about:blank"],
            pass_fds=(to_browser, from_browser),
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._number, self._rest = 0, b""

    def call(self, method: str, session: str | None = None, **values: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": values}
        if session:
            message["sessionId"] = session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            heard = self._message()
            if heard.get("id") == self._number:
                assert "error" not in heard, (method, heard["error"])
                result: dict[str, Any] = heard["result"]
                return result
            listener = self.listeners.get(heard.get("sessionId", ""))
            if listener and "method" in heard:
                listener(heard["method"], heard["params"])

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            piece = os.read(self._read, 1 << 20)
            assert piece, "the browser has ended"
            self._rest += piece
        text, _, self._rest = self._rest.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        return message

    def page(self) -> Page:
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        return Page(self, session)

    def close(self) -> None:
        # Debian's program is a wrapper: the whole group has to go.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        os.close(self._write)
        os.close(self._read)


def program() -> str | None:
    """The browser of this machine; `make tools` installs Debian's."""
    return next((found for name in _NAMES if (found := shutil.which(name))), None)


def no_browser() -> NoReturn:
    """Fail the test; skip it on Ubuntu, which has no package of Chromium but a snap."""
    is_ubuntu = platform.freedesktop_os_release().get("ID") == "ubuntu"
    (pytest.skip if is_ubuntu else pytest.fail)("no Chromium here: make tools")


@pytest.fixture(scope="session")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    """A browser for all tests."""
    found = program() or no_browser()
    browser = Chromium(found, tmp_path_factory.mktemp("profile"))
    try:
        yield browser
    finally:
        browser.close()
