"""What the gateway says of a stop, asked again and again, beside what the bus had."""

import contextlib
import subprocess
import time
from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Any, NamedTuple

from tests.oracle import wire
from tests.oracle.bench import Bench
from tests.oracle.recorder import Frame
from tests.oracle.watching import TICK_S

ASKED_EVERY_S = 0.015
STAMPS_AGREE_S = 0.003  # two clocks read one after the other, and ages rounded to a tenth of a ms
SETTLE_S, UNKNOWN_S, GAP_S = 0.100, 1.600, 0.150  # of docs/safety.md
NEXT_TICK_S = TICK_S + 0.025  # the tick that judges it, and what may make that one late
CONTROLLERS = {"PCU1": wire.PCU1_COMMAND, "PCU2": wire.PCU2_COMMAND}
STATUS1 = tuple(f"{pcu}_Status1" for pcu in CONTROLLERS)
LATCHED, SENT, ON_BUS, CUT, NOT_OBEYED = "latched", "sent", "on the bus", "cut", "not obeyed"


class Told(NamedTuple):
    """One answer to `state.get`: the instant that it is of, the stop, the commands."""

    t: float
    stop: dict[str, Any] | None
    commands: dict[str, Any]

    @property
    def stage(self) -> str | None:
        return self.stop["stage"] if self.stop else None

    @property
    def sentence(self) -> str | None:
        return self.stop["sentence"] if self.stop else None

    def of(self, pcu: str) -> dict[str, Any]:
        assert self.stop, "no stop"
        return self.stop["controllers"][pcu]

    def at(self, pcu: str, age: str) -> float | None:
        """The instant that an age of a controller's stop means."""
        age_ms = self.of(pcu)[age]
        return None if age_ms is None else self.t - age_ms / 1000


def told(bench: Bench) -> Told:
    state = bench.client.call("state.get", messages=[])
    return Told(state["monotonic_ns"] / 1e9, state["stop"], state["commands"])


def watched(bench: Bench, for_s: float) -> list[Told]:
    """Every answer for so long."""
    until = time.monotonic() + for_s
    seen = [told(bench)]
    while time.monotonic() < until:
        bench.rest(ASKED_EVERY_S)
        seen.append(told(bench))
    return seen


def stages(seen: Iterable[Told]) -> list[str | None]:
    """Those that were seen, in order, each once as long as it lasts."""
    return [stage for stage, _ in groupby(one.stage for one in seen)]


def until_stage(bench: Bench, wanted: str, patience_s: float = 3.0) -> list[Told]:
    """Every answer until that stage is told."""
    seen: list[Told] = []

    def there() -> bool:
        seen.append(told(bench))
        return seen[-1].stage == wanted

    bench.wait(there, f"the stage {wanted!r}", patience_s)
    return seen


def press(bench: Bench) -> float:
    pressed = time.monotonic()
    bench.client.call("estop")
    return pressed


def first_cuts(bench: Bench, since: float) -> dict[str, float]:
    """When the listener had the first POWER_CUT frame of each controller."""

    def there() -> dict[str, Frame]:
        cuts = [f for f in reversed(bench.commands(since)) if f.command.cut]
        found = {pcu: f for pcu, can_id in CONTROLLERS.items() for f in cuts if f.can_id == can_id}
        return found if len(found) == len(CONTROLLERS) else {}

    return {pcu: frame.t for pcu, frame in bench.wait(there, "POWER_CUT", 1.0).items()}


def report(bench: Bench, *names: str, at: float | None = None) -> float:
    """Status1 of these controllers at that instant, or now; the listener's stamp of the last."""
    since = time.monotonic()
    after = 0.0 if at is None else max(0.0, at - since)
    bench.vehicle.script(*((after, f"{pcu}_Status1", {}) for pcu in names))
    return max(bench.frame(f"{pcu}_Status1", since).t for pcu in names)


def ignores(bench: Bench, *names: str) -> None:
    """From now on these controllers say that they drive on, with 19.9 %."""
    for pcu in names:
        bench.vehicle.echo(pcu, cut=0, throttle=51)


def obeys(bench: Bench, *names: str) -> None:
    for pcu in names:
        bench.vehicle.echo(pcu)


@contextlib.contextmanager
def disturbed(bench: Bench, *change: str, undone: tuple[str, ...]) -> Iterator[None]:
    """The interface otherwise, by `ip` or `tc`; the frames that lack are the test's own doing."""
    subprocess.run(change, check=True)
    try:
        yield
    finally:
        subprocess.run(undone, check=True)
        bench.rest(TICK_S)
        bench.rules.begin()


def full_queue(bench: Bench) -> contextlib.AbstractContextManager[None]:
    """The kernel takes no frame of anybody: ENOBUFS."""
    discipline = ("dev", wire.CHANNEL, "root")
    return disturbed(
        bench, "tc", "qdisc", "replace", *discipline, "pfifo", "limit", "0",
        undone=("tc", "qdisc", "del", *discipline),
    )  # fmt: skip


def link_down(bench: Bench) -> contextlib.AbstractContextManager[None]:
    link = ("ip", "link", "set", wire.CHANNEL)
    return disturbed(bench, *link, "down", undone=(*link, "up"))
