"""Who drives: a client of the service's API, as root, and what its frames look like."""

import contextlib
import itertools
from collections.abc import Sequence

from tests.faults.driving import MS, THROTTLE_PCT, ZERO_TORQUE
from tests.service.unit import RUNTIME
from tests.vcan.conftest import COMMANDS, Recorded, Recording, wait_until
from vcu_gateway.client import Client, ClientError, DemandOwner

PATIENCE_S = 60.0
THROTTLE_RAW = 51  # 20 %


class Driver:
    """Holds the demand from `take` to `let_go`, whatever becomes of the gateway meanwhile."""

    def __init__(self, recording: Recording) -> None:
        self.client = Client(RUNTIME / "control.sock", timeout_s=PATIENCE_S)
        self._recording = recording
        self._owner: DemandOwner | None = None

    def mode(self) -> str:
        """Of the gateway; "" while it cannot be asked."""
        try:
            return self.client.why()["mode"]
        except ClientError:
            return ""

    def until_standby(self) -> None:
        wait_until(lambda: self.mode() == "standby", "standby", PATIENCE_S)

    def settle(self) -> None:
        """To standby, where an earlier drive of the same service may have ended in a fault.

        A lab may stall for longer than a drive outlives.
        """
        wait_until(self._settled, "standby, by reset", PATIENCE_S)

    def _settled(self) -> bool:
        mode = self.mode()
        with contextlib.suppress(ClientError):  # refused for now
            if mode == "fault":
                self.client.reset("service")
        return mode == "standby"

    def take(self) -> None:
        """The pedals, not pressed."""
        if self._owner is None:
            self._owner = self.client.demand("driver", ttl_ms=1000, hold_s=None).__enter__()
        self._owner.set(power_mode="normal")

    def drive(self) -> None:
        """From wherever it is to throttle on the bus, at both controllers.

        A lab may stall for longer than a fault takes: then by reset, and armed again.
        """
        wait_until(self._drives, "throttle on the bus", PATIENCE_S)

    def _drives(self) -> bool:
        mode = self.mode()
        with contextlib.suppress(ClientError):  # refused for now, or restarting
            if mode == "active" and self._owner is not None:
                self._owner.set(throttle_pct=THROTTLE_PCT, power_mode="normal")
                return self.throttles() == {THROTTLE_RAW}
            if mode in ("fault", "standby"):
                self.take()
            if mode == "fault":
                self.client.reset("service")
            if mode == "standby":
                self.client.arm()
        return False

    def let_go(self) -> None:
        """Also of a gateway that is gone."""
        if self._owner is not None:
            self._owner.release()
            self._owner = None

    def commands(self, since_ns: int = 0, until_ns: int | None = None) -> list[Recorded]:
        return [
            frame
            for frame in self._recording.commands()
            if since_ns < frame.stamp_ns and (until_ns is None or frame.stamp_ns < until_ns)
        ]

    def between(self, since_ns: int, until_ns: int) -> list[Recorded]:
        """All of that time: the recorder is a process of its own, so a later one is waited for."""
        self.until_commands(1, until_ns)
        return self.commands(since_ns, until_ns)

    def throttles(self) -> set[int]:
        """The last one of each controller."""
        last = {frame.can_id: frame.data[1] for frame in self.commands()[-4:]}
        return {last.get(can_id, 0) for can_id in COMMANDS}

    def until_commands(self, count: int, since_ns: int) -> list[Recorded]:
        """That many frames and more, of both controllers together."""
        wait_until(
            lambda: len(self.commands(since_ns)) >= count, f"{count} command frames", PATIENCE_S
        )
        return self.commands(since_ns)

    def until_zero_torque_alone(self, since_ns: int, count: int = 10) -> list[Recorded]:
        """Frames since then; every one of them is ZERO_TORQUE."""
        frames = self.until_commands(count, since_ns)
        assert {frame.data for frame in frames} == {ZERO_TORQUE}
        return frames


def gaps_ms(frames: Sequence[Recorded]) -> list[float]:
    """Between frames of one controller, of both controllers."""
    found = []
    for can_id in COMMANDS:
        stamps_ns = [frame.stamp_ns for frame in frames if frame.can_id == can_id]
        found += [(after - before) / MS for before, after in itertools.pairwise(stamps_ns)]
    return found
