"""A gateway in a process of its own for each module, and users with known passwords."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.web.stand import GatewayProcess, gateway_running

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
