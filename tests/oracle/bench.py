"""Bench: the rig, and what a test measures on it."""

import contextlib
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

from tests.oracle import wire
from tests.oracle.api import Client
from tests.oracle.recorder import SLOW_S, Frame
from tests.oracle.rig import Rig

# From the cause's frame to the last frame that may not know it: a tick that has begun.
GRACE_S = 0.015
REACTION_S = 0.050 + 0.002 + 0.020


class Bench(Rig):
    """The rig, and how to look at it."""

    def last_pair(self) -> tuple[Frame, Frame]:
        """The two frames of the last tick that sent both."""
        frames = self.commands(time.monotonic() - 0.5)
        pairs = [two for two in pairwise(frames) if two[1].t - two[0].t < 0.020]
        return pairs[-1]

    def frame(
        self, name: str, since: float, wanted: Callable[[bytes], bool] | None = None
    ) -> Frame:
        """The first frame of a message after an instant, as soon as it is there."""

        def there() -> Frame | None:
            frames = self.recorder.of(name, since)
            return next((f for f in frames if wanted is None or wanted(f.data)), None)

        return self.wait(there, f"{name}", 3.0)

    def ticks(self, since: float, count: int) -> list[Frame]:
        """The next frames to PCU1, so many of them."""

        def enough() -> list[Frame] | None:
            frames = self.recorder.commands_since(since)
            one = [f for f in frames if f.can_id == wire.PCU1_COMMAND]
            return one[:count] if len(one) >= count else None

        return self.wait(enough, f"{count} ticks", 0.5 + count * 0.1)

    def must_be_safe_after(self, cause_t: float, wanted: bytes, for_s: float = 0.130) -> None:
        """Every frame of a tick that began after the cause is that safe frame."""
        self.until(cause_t + for_s)
        frames = self.commands(cause_t + GRACE_S)
        told = [f"{(f.t - cause_t) * 1000:.1f} ms {f.can_id:08X}#{f.data.hex()}" for f in frames]
        assert frames, "no command at all"
        assert {f.can_id for f in frames} == set(wire.COMMANDS)
        assert all(f.data == wanted for f in frames), f"wanted {wanted.hex()}: {told[:8]}"
        first = min(f.t for f in self.commands(cause_t) if f.data == wanted)
        assert first - cause_t <= REACTION_S, f"{(first - cause_t) * 1000:.1f} ms: {told[:8]}"

    # --- the machine ---

    def of_ten(self, trial: Callable[[int], bool], *, still_s: float = 0.0) -> int:
        """How many of ten trials were right; one during which the machine was slow comes again.

        `still_s` is how long a trial holds the gateway still by itself.
        """
        right = repeated = 0
        for number in range(10):
            began = time.monotonic()
            while not (done := trial(number)) and repeated < 10 and self.disturbed(began, still_s):
                repeated += 1
                self.standby()
                began = time.monotonic()
            right += done
        self.repeated += repeated
        return right

    def disturbed(self, since: float, still_s: float = 0.0) -> bool:
        """Whether the machine stood still, was slow or had frames left out: this says nothing."""
        self.pump()
        return self.machine_was_slow(since) or self._longest_gap_s(since) > 0.080 + still_s

    def machine_was_slow(self, since: float) -> bool:
        return self.recorder.stalled(since, for_s=SLOW_S) or self.speed.is_slow()

    def _longest_gap_s(self, since: float) -> float:
        """Between two commands to one controller; also one that had begun before."""
        frames = self.recorder.commands_since(since - 1.0)
        times = [[f.t for f in frames if f.can_id == can_id] for can_id in wire.COMMANDS]
        pairs = [two for one in times for two in pairwise(one)]
        return max((after - before for before, after in pairs if after > since), default=0.0)

    @contextlib.contextmanager
    def another(self) -> Iterator[Client]:
        client = self.gateway.client()
        try:
            yield client
        finally:
            client.close()

    def leaves_out(self) -> bool:
        """Whether frames are missing that the vehicle's beat does not lay on the machine.

        From the third on: one or two may be its fault in a way that the beat does not show.
        """
        self.pump()
        return len(self._left_out()) > 2

    def broken_rules(self) -> list[str]:
        """What the frames since the last question broke; also those that were left out."""
        missing = self.leaves_out()
        broken, ours = list(self.rules.violations), self._left_out()
        self.void()
        if missing and not self.speed.is_slow():
            broken += [*ours, self._health()]
        return broken

    def void(self) -> None:
        """Forget what broke a rule; what was left out is counted, and told at the end."""
        self.left_out += len(self._left_out())
        self.rules.violations.clear()
        self.rules.left_out.clear()

    def _left_out(self) -> list[str]:
        return [
            f"{t:.4f} {what}"
            for t, what in self.rules.left_out
            if not self.recorder.stalled(t - 0.25, t, SLOW_S)
        ]

    def _health(self) -> str:
        if not self.client:
            return ""
        health = self.client.call("health")
        return f"{health['ticks']} {health['frames']}"
