"""A gateway in a process of its own for each module, and users with known passwords."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.web.stand import GatewayProcess, WebProcess, gateway_running, serving

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext

PASSWORD = "correct horse battery"
# Cheap ones: the real costs are tried in test_users.py.
USERS = ("anna viewer", "otto operator", "sara service")


def users_lines() -> str:
    from vcu_gateway.web.users import PasswordHash

    hashed = PasswordHash.of(PASSWORD).text()
    return "".join(f"{user} {hashed}\n" for user in USERS)


@pytest.fixture
def users_file(tmp_path: Path) -> Path:
    path = tmp_path / "web-users"
    path.write_text(users_lines())
    path.chmod(0o640)
    return path


@pytest.fixture
def short_folder() -> Iterator[Path]:
    """A folder whose name leaves room for a socket's."""
    folder = Path(tempfile.mkdtemp(prefix="vcu-web."))
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def gateway() -> Iterator[GatewayProcess]:
    folder = Path(tempfile.mkdtemp(prefix="vcu-web."))
    with gateway_running(folder) as one:
        yield one
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def web(tmp_path_factory: pytest.TempPathFactory, gateway: GatewayProcess) -> Iterator[WebProcess]:
    """The page's server, for whoever may do everything."""
    options = ("--local-role", "service")
    with serving(tmp_path_factory.mktemp("web"), gateway.socket_path, *options) as one:
        yield one


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    from tests.web.browser import chromium

    with chromium() as one:
        yield one


@pytest.fixture
def context(browser: "Browser") -> "Iterator[BrowserContext]":
    from tests.web.browser import context_of

    with context_of(browser) as one:
        yield one


@pytest.fixture
def stopped(gateway: GatewayProcess) -> Iterator[None]:
    """Whatever a test stops can be driven again, by controllers that obey on a whole bus."""
    yield
    gateway.ask("interface", "whole")
    gateway.ask("silence")
    gateway.ask("deafen")
    gateway.ask("park")
    gateway.ask("reset")
