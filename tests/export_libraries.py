"""asammdf, pyarrow and mcap, installed for the tests of export in a folder of their own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PATIENCE_S = 600


@pytest.fixture(scope="session")
def export_folder() -> Path:
    """Folder of the libraries; installed where it is not there."""
    found = subprocess.run(
        [ROOT / "scripts" / "test-export", Path(sys.executable).parent],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    if found.returncode:
        pytest.fail(found.stderr.strip().splitlines()[-1])
    return Path(found.stdout.strip())


def with_export_libraries(folder: Path) -> dict[str, str]:
    """The environment of a process in which they are installed."""
    return {**os.environ, "PYTHONPATH": str(folder)}
