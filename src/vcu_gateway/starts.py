"""How often the gateway has started since the machine booted."""

import contextlib
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_NAME = "starts"


def count_start(folder: Path) -> int | None:
    """Count this start in a file in `folder`; None where that cannot be kept."""
    try:
        boot = _BOOT_ID.read_text().strip()
        number = _known(folder / _NAME, boot) + 1
        (folder / _NAME).write_text(f"{boot} {number}\n")
    except OSError:
        return None
    return number


def _known(path: Path, boot: str) -> int:
    with contextlib.suppress(OSError, ValueError):
        written, number = path.read_text(encoding="ascii").split()
        if written == boot:
            return int(number)
    return 0
