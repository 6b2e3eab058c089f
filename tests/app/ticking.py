"""A gateway with its API and a vehicle, and the lateness of every tick: ticking.py FOLDER.

Until SIGTERM; FOLDER/lateness has a line a tick: deadline and lateness, both in ns.
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

    def note(tick: Tick, result: TickResult) -> None:
        del result
        ticks.write(f"{tick.deadline_ns} {tick.lateness_ns}\n")

    with open(folder / "lateness", "w", buffering=1) as ticks, driven(folder) as gateway:
        gateway.loop.add_observer(note)
        gateway.until_ready()
        print("ready", flush=True)
        end.wait()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
