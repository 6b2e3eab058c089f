"""A disk that fails on demand: calls of the recorder's process fail as the kernel fails them."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

_SOURCE = Path(__file__).with_name("disk_faults.c")


class FaultyDisk:
    """Library to load before the recorder's own calls, and the word that it reads."""

    def __init__(self, folder, disk):
        if shutil.which("cc") is None:
            pytest.fail("no C compiler here: make tools")
        self._mode = Path(folder) / "disk-mode"
        self._log = Path(folder) / "disk-log"
        library = Path(folder) / "disk_faults.so"
        command = ["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(_SOURCE), "-ldl"]
        subprocess.run(command, check=True)
        self.becomes("ok")
        self.environment = {
            "LD_PRELOAD": str(library),
            "DISK_FAULTS_FOLDER": str(Path(disk).resolve()),
            "DISK_FAULTS_MODE": str(self._mode),
            "DISK_FAULTS_LOG": str(self._log),
        }

    def becomes(self, word):
        """ok, full, failing, readonly or stalled; from the next call on."""
        new = self._mode.with_suffix(".new")
        new.write_text(word)
        os.replace(new, self._mode)

    @property
    def syncs_s(self):
        """When fdatasync succeeded, on the monotonic clock."""
        lines = self._log.read_text().splitlines() if self._log.exists() else []
        return [int(line.split()[1]) / 1e9 for line in lines]
