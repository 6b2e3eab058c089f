"""Millions of random frames into the whole gateway, with ticks, drives and a second opinion.

    python -m tests.faults.random_frames --frames 10000000 [--seed 1]

Half of the rounds are calm: what is wrong in them must not take the torque. After every frame the
second opinion has counted the same, after every tick the invariants of docs/safety.md hold
(tests/core/test_invariants.py). Status 1, with the seed, where anything does not.
"""

import argparse
import random
import sys
import time
from typing import NamedTuple

from tests.core.test_invariants import (
    ALL_RECEIVED_IDS,
    CODEC,
    COMMAND_IDS,
    COUNTS,
    ID_OF,
    MS,
    GatewayMachine,
)
from tests.faults.machine import resident_kb
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode

FRAMES_OF_A_TICK = 50
TICKS_OF_A_ROUND = 40
GROWTH_MAX_KB = 1024
WARM_UP = 5  # the first fifth: by then the allocator has grown to its size
DECIDING = frozenset(
    can_id for name, can_id in ID_OF.items() if name.startswith(("BMS_Status", "PCU"))
)
ALL_IDS = (*ALL_RECEIVED_IDS, *COMMAND_IDS)
CALM_IDS = tuple(can_id for can_id in ALL_RECEIVED_IDS if can_id not in DECIDING)
HEALTHY = {
    ID_OF[name] & 0x03FF_FFFF: bytes.fromhex(data)
    for name, data in {
        "BMS_Status": "8813000050000002",
        "PCU1_Status1": "0000008300001e1e",
        "PCU2_Status1": "0000008300001e1e",
    }.items()
}
ASKED = [
    dict.fromkeys(
        ("PCU1", "PCU2"),
        ControllerDemand(throttle_pct=throttle, brake_pct=brake, power_mode=mode, regen_brake=True),
    )
    for throttle, brake, mode in (
        (100.0, 0.0, PowerMode.TURBO),
        (20.0, 30.0, PowerMode.NORMAL),
        (60.0, 5.0, PowerMode.ECO),
    )
]


class Ran(NamedTuple):
    """What came of it."""

    frames: int
    ticks: int
    active: int
    with_throttle: int
    seconds: float
    growth_kb: int

    def __str__(self) -> str:
        return (
            f"{self.frames:,} frames in {self.seconds:.0f} s,"
            f" {self.frames / self.seconds:,.0f} a second with all checks; {self.ticks:,} ticks,"
            f" {self.active / self.ticks:.0%} of them ACTIVE,"
            f" {self.with_throttle / self.ticks / 2:.0%} with throttle; memory +{self.growth_kb} kB"
        )


class Maker:
    """Frames of every kind, from one seed."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)

    def frame(self, now_ns: int, calm: bool) -> Frame:
        """One frame that arrived about now."""
        kind = self.chance.random()
        if kind < 0.4:
            return self._anything(now_ns, calm)
        if kind < 0.75:
            return self._mutated(now_ns, calm)
        can_id, chance = self._known(calm), self.chance
        if kind < 0.85:
            return Frame(can_id, chance.randbytes(8), now_ns)
        if kind < 0.95:
            return Frame(
                can_id ^ 1 << chance.randrange(26), chance.randbytes(8), now_ns, own_echo=calm
            )
        length = chance.choice((0, 1, 4, 7, 9, 12, 16, 64))
        return Frame(can_id, bytes(length), now_ns)

    def _known(self, calm: bool) -> int:
        """An identifier of ours with any priority."""
        can_id = self.chance.choice(CALM_IDS if calm else ALL_IDS)
        return can_id & 0x03FF_FFFF | self.chance.getrandbits(3) << 26

    def _anything(self, now_ns: int, calm: bool) -> Frame:
        chance = self.chance
        bits = chance.getrandbits(64)
        extended = bits & 3 != 0
        return Frame(
            bits >> 8 & (0x1FFF_FFFF if extended else 0x7FF),
            chance.randbytes(bits >> 40 & 63 if bits & 4 else 8),
            now_ns + self._offset_ns(bits >> 48),
            extended,
            remote=bits >> 56 & 31 == 0,
            error=not calm and bits >> 56 & 31 == 1,
            own_echo=bits >> 61 == 0,
        )

    def _offset_ns(self, bits: int) -> int:
        """Mostly now; sometimes old, out of order or in the future."""
        if bits & 7:
            return 0
        return (-3_000, -500, -50, -1, 0, 15, 25, 1_000_000)[bits >> 3 & 7] * MS

    def _mutated(self, now_ns: int, calm: bool) -> Frame:
        can_id = self._known(calm)
        data = int.from_bytes(HEALTHY.get(can_id & 0x03FF_FFFF, bytes(8)), "big")
        for _ in range(self.chance.randrange(3)):
            data ^= 1 << self.chance.randrange(64)
        own_echo = calm or self.chance.random() < 0.3
        return Frame(can_id, data.to_bytes(8, "big"), now_ns, own_echo=own_echo)


def run(frames: int, seed: int, tell_every: int = 0) -> Ran:
    """So many frames; AssertionError where an invariant does not hold."""
    maker, machine = Maker(seed), GatewayMachine()
    COUNTS.clear()
    GatewayMachine.begin(machine, settings=Settings(), warm=True)
    sent, begun_s, before_kb, rounds = 0, time.monotonic(), 0, 0
    while sent < frames:
        calm = rounds % 2 == 0
        rounds += 1
        machine._make_well()
        machine._settle()
        for tick in range(TICKS_OF_A_ROUND):
            for _ in range(FRAMES_OF_A_TICK):
                machine._receive(maker.frame(machine.now_ns, calm))
            machine._step(ASKED[rounds % 3] if tick < TICKS_OF_A_ROUND - 5 else None)
        sent += FRAMES_OF_A_TICK * TICKS_OF_A_ROUND
        GatewayMachine.everything_is_counted_and_bounded(machine)
        GatewayMachine.why_answers(machine)
        if not before_kb and sent >= frames // WARM_UP:
            before_kb = resident_kb()
        if tell_every and sent % tell_every < FRAMES_OF_A_TICK * TICKS_OF_A_ROUND:
            print(f"{sent:,} frames, memory {resident_kb()} kB", flush=True)
    return Ran(
        frames=sent,
        ticks=COUNTS["ticks"],
        active=COUNTS[Mode.ACTIVE],
        with_throttle=COUNTS["with throttle"],
        seconds=time.monotonic() - begun_s,
        growth_kb=resident_kb() - before_kb,
    )


def receiver_rate(frames: int = 200_000) -> float:
    """Frames a second through `Gateway.receive` alone, of the same kinds."""
    maker = Maker(0)
    made = [maker.frame(0, calm=False) for _ in range(frames)]
    receive = Gateway(CODEC, Settings(), 0).receive
    begun_s = time.perf_counter()
    for frame in made:
        receive(frame)
    return frames / (time.perf_counter() - begun_s)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().getrandbits(32))
    given = parser.parse_args()
    print(f"seed {given.seed}", flush=True)
    ran = run(given.frames, given.seed, tell_every=1_000_000)
    print(f"{ran}\nthrough the receiver alone {receiver_rate():,.0f} frames a second")
    return 0 if ran.growth_kb < GROWTH_MAX_KB else 1


if __name__ == "__main__":
    sys.exit(main())
