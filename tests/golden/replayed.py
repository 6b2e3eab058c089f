"""Golden drives replayed with the core as it is now, and the report of what is otherwise."""

from typing import NamedTuple

from tests.golden.recording import FOLDER
from tests.golden.scripts import GoldenDrive
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.errors import GatewayError
from vcu_gateway.recording.reader import open_drive
from vcu_gateway.replay.equality import Equality, EqualityCheck
from vcu_gateway.units import NS_PER_S

FIELDS_SHOWN = 8


class Replayed(NamedTuple):
    """A golden drive and how its replay compares; a reason instead where it cannot be replayed."""

    golden: GoldenDrive
    equality: Equality | None
    cannot: str = ""

    @property
    def is_equal(self) -> bool:
        return self.equality is not None and self.equality.equal and not self.equality.not_replayed

    def lines(self) -> list[str]:
        """Report: how much is different, and the first place; empty where all is equal."""
        if self.equality is None:
            return [f"{self.golden.name}: {self.cannot}"]
        first, found = self.equality.first_difference, self.equality
        if first is None:
            return []
        at_s = (first.now_ns - self.golden.start_ns) / NS_PER_S
        fields = sorted(found.differences.items(), key=lambda item: -item[1])[:FIELDS_SHOWN]
        counts = ", ".join(f"{name} {count}" for name, count in fields)
        ticks = f"{found.ticks - found.equal_ticks} of {found.ticks} ticks differ"
        return [
            f"{self.golden.name}: {ticks} ({counts})",
            f"  first: tick {first.tick}, {at_s:.3f} s, {first.field}",
            f"    before: {first.recorded}",
            f"    after:  {first.replayed}",
        ]


def replay(golden: GoldenDrive, to_the_end: bool = True) -> Replayed:
    """Replay one from the beginning of its gateway, or only until it is different.

    It begins with a new gateway and not with the recorded state: a part of the core that is
    only named otherwise changes no byte.
    """
    try:
        drive = open_drive(FOLDER / golden.name)
        gateway = Gateway(golden.codec, drive.info.settings, golden.start_ns)
        check = EqualityCheck(golden.codec, gateway)
        for record in drive.runs():
            check.note(record)
            if check.is_different and not to_the_end:
                break
    except (GatewayError, ValueError, KeyError) as error:
        return Replayed(golden, None, f"cannot be replayed: {error}")
    return Replayed(golden, check.result())
