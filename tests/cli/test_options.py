"""What several verbs share: the event that a signal sets."""

import subprocess
import sys

# Python calls the handler of a signal in the main thread, here while that holds the event's lock,
# as it does for a moment at the beginning and the end of each wait.
PROGRAM = """
import signal
from vcu_gateway.cli.options import stopped_by_signals
with stopped_by_signals(signal.SIGHUP) as stop:
    with stop._cond:
        signal.raise_signal(signal.{name})
    print(stop.wait(10))
"""


def test_a_signal_that_comes_while_the_event_is_being_waited_for_ends_the_wait():
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        found = subprocess.run(
            [sys.executable, "-c", PROGRAM.format(name=name)],
            capture_output=True,
            text=True,
            timeout=20,
        )
        assert (found.stdout, found.stderr) == ("True\n", "")
