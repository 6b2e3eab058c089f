"""A gateway with its API and a vehicle, and the lateness of every tick: ticking.py FOLDER.

Until SIGTERM; FOLDER/lateness has a line a tick: deadline and lateness, both in ns.
"""

import signal
import sys
import threading
from pathlib import Path

from tests.driven import driven
from vcu_gateway.core.gateway import TickResult


def main(folder: Path) -> None:
    end = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: end.set())

    def note(result: TickResult) -> None:
        del result
        schedule = gateway.loop.schedule
        deadline_ns = schedule.next_deadline_ns - schedule.period_ns
        ticks.write(f"{deadline_ns} {schedule.recent_lateness_ns[-1]}\n")

    with open(folder / "lateness", "w", buffering=1) as ticks, driven(folder) as gateway:
        gateway.loop.add_observer(note)
        gateway.until_ready()
        print("ready", flush=True)
        end.wait()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
