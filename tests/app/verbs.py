"""A verb of the command line, asked of a running gateway, and how far a stop of it has come."""

import os
import subprocess
import sys

from tests.driven import Driven


def vcu(socket_path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "VCU_GATEWAY_SOCKET": str(socket_path)}
    command = [sys.executable, "-m", "vcu_gateway", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, env=environment)


def stage_of(gateway: Driven) -> str | None:
    """How far a stop has come; None where none is latched."""
    latest = gateway.loop.latest
    return latest.stop.stage.value if latest and latest.stop else None
