"""A gateway with its API and a vehicle, and the lateness of every tick: ticking.py FOLDER.

Until SIGTERM; then FOLDER/lateness has a line a tick: deadline and lateness, both in ns.
"""

import signal
import sys
import threading
from pathlib import Path

from tests.driven import driven
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.schedule import Tick


def main(folder: Path) -> None:
    end = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: end.set())
    ticks: list[str] = []

    def note(tick: Tick, result: TickResult) -> None:
        del result
        ticks.append(f"{tick.deadline_ns} {tick.lateness_ns}")

    with driven(folder) as gateway:
        gateway.daemon.observe_with(note)
        gateway.until_ready()
        print("ready", flush=True)
        end.wait()
    (folder / "lateness").write_text("\n".join(ticks))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
