"""In the guest: a recorder on the disk that the test will cut off, and ticks handed to it.

    python -m tests.power_cut.drive_recorded FOLDER [LATCH_AT_TICK]

Prints each tick when the recorder has taken it, by the stamp that its core line has.
"""

import sys
import time

from tests.recorder.gateway import TICK_S, Gateway, RecorderProcess


def main(folder: str, latch_at: str = "0") -> None:
    recorder = RecorderProcess(folder)
    gateway = Gateway(recorder.socket)
    gateway.connect(timeout_s=60)
    due_s, number = time.monotonic(), 0
    while True:
        number += 1
        latched = number == int(latch_at)
        taken = gateway.latch() if latched else gateway.tick()
        print(
            "latched" if latched else "tick" if taken else "lost", time.monotonic_ns(), flush=True
        )
        due_s += TICK_S
        time.sleep(max(0.0, due_s - time.monotonic()))


main(*sys.argv[1:])
