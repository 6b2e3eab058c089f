"""A gateway of a test hands its drive to nobody, unless the test says to whom."""

from pathlib import Path

SOCKET = "nobody.sock"


def unrecorded(folder: Path, config: str) -> str:
    """The configuration with a recorder's socket where nobody listens; where it names one, that.

    The default one may be that of this machine's recorder. The lines keep their numbers.
    """
    if "recorder:" in config:
        return config
    return f"{config.rstrip()}\nrecorder: {{socket_path: {folder / SOCKET}}}\n"
