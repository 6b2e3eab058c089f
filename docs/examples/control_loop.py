#!/usr/bin/env python3
"""Drive for a while: a control loop at 50 Hz with a ramp, on absolute deadlines.

The loop watches the vehicle's mode and ends, with the gateway's reason, as soon as it is not
active any more. Ctrl-C ends it too; whatever ends it, no motion is asked for at the end.
"""

import argparse
import logging
import sys
import threading
import time

from vcu_gateway.client import Client, ClientError, DemandOwner, RefusedError, Subscription

PERIOD_S = 0.02
STATE_TOO_OLD_S = 0.5
MODE_CHANGES_WITHIN_S = 1.0

log = logging.getLogger("control_loop")


class View:
    """The vehicle's mode, kept up to date by a thread that reads a subscription."""

    def __init__(self, updates: Subscription) -> None:
        self._updates = updates
        self._mode = "unknown"
        self._seen_s = time.monotonic()
        self._changed = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            for update in self._updates:
                with self._changed:
                    self._mode, self._seen_s = update["state"]["mode"], time.monotonic()
                    self._changed.notify_all()
        except ClientError as error:
            log.warning("the subscription ended: %s", error)

    @property
    def mode(self) -> str:
        """The mode; unknown where nothing was heard for a while."""
        fresh = time.monotonic() - self._seen_s < STATE_TOO_OLD_S
        return self._mode if fresh else "unknown"

    def wait_for(self, mode: str, timeout_s: float) -> bool:
        """Whether this mode came in time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._mode == mode, timeout_s)


def arm(client: Client, patience_s: float) -> bool:
    """Arm, waiting for as long as the gateway has a reason against it that may pass."""
    end_s = time.monotonic() + patience_s
    told = ""
    while True:
        try:
            client.arm()
        except RefusedError as refusal:
            if refusal.sentence != told:
                log.info("not armed yet: %s", refusal)
                told = refusal.sentence
        else:
            return True
        if time.monotonic() > end_s:
            return False
        time.sleep(0.2)


def next_deadline(deadline_s: float, now_s: float) -> float:
    """The next point of the grid that is still to come: a missed one is skipped, not made up."""
    missed = max(0, int((now_s - deadline_s) / PERIOD_S))
    return deadline_s + (missed + 1) * PERIOD_S


def drive(owner: DemandOwner, view: View, throttle_pct: float, ramp_s: float, for_s: float) -> bool:
    """Ramp the throttle up and hold it; False where the vehicle ended the drive."""
    start_s = deadline_s = time.monotonic()
    while deadline_s < start_s + for_s:
        if view.mode != "active":
            return False
        share = min(1.0, (deadline_s - start_s) / ramp_s)
        owner.set(throttle_pct=throttle_pct * share)
        deadline_s = next_deadline(deadline_s, time.monotonic())
        time.sleep(max(0.0, deadline_s - time.monotonic()))
    return True


def run(client: Client, args: argparse.Namespace) -> int:
    """The whole drive; the exit code."""
    log.info("before: %s", client.why()["sentence"])
    with client.demand("control-loop") as owner, client.subscribe([], rate_hz=20) as updates:
        view = View(updates)
        if not arm(client, args.patience_s):
            log.error("given up: %s", client.why()["sentence"])
            return 1
        view.wait_for("active", MODE_CHANGES_WITHIN_S)
        log.info("driving")
        if not drive(owner, view, args.throttle_pct, args.ramp_s, args.for_s):
            log.error("the drive ended: %s", client.why()["sentence"])
            return 1
    log.info("done")
    return 0


def main() -> int:
    """Parse the command line and drive; 0 done or interrupted, 1 with a reason on stderr."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--socket", help="the gateway's socket; default: as the client finds it")
    parser.add_argument("--throttle-pct", type=float, default=10, help="default: %(default)s")
    parser.add_argument("--ramp-s", type=float, default=4, help="default: %(default)s")
    parser.add_argument("--for-s", type=float, default=10, help="default: %(default)s")
    parser.add_argument(
        "--patience-s", type=float, default=10, help="for arming; default: %(default)s"
    )
    args = parser.parse_args()
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    try:
        with Client(args.socket) as client:
            return run(client, args)
    except KeyboardInterrupt:
        log.info("interrupted")
        return 0
    except ClientError as error:
        log.error("%s", error)
        return 1


if __name__ == "__main__":
    sys.exit(main())
