"""The inside of the scripted vehicle: healthy until told otherwise, exact in time.

It sends what battery, inertial unit, steering and both controllers send, at their periods; the
controllers answer every command with Status2 and echo it in Status1.
"""

import contextlib
import functools
import heapq
import itertools
import os
import select
import signal
import socket
import time
from collections.abc import Callable

from tests.oracle import pedal_node, wire

BEAT_MS = 10
# A third of the inertial unit's rate, but where a test asks for all of it: its 300 frames a second
# cost the lab's one processor more than everything else together.
IMU_CALM_MS = 30
CONTROLLERS = {"PCU1": wire.PCU1_COMMAND, "PCU2": wire.PCU2_COMMAND}


def healthy() -> dict:
    state = {
        "BMS_Status": dict(wire.BMS_HEALTHY),
        "BMS_Temperatures": dict(wire.TEMPERATURES_HEALTHY),
        "ARD2_SteeringWheel": dict(wire.ARD2_HEALTHY),
        pedal_node.MESSAGE: dict(pedal_node.RELEASED),
    }
    for pcu in CONTROLLERS:
        state[f"{pcu}_Status1"] = dict(wire.STATUS1_HEALTHY)
        state[f"{pcu}_Status2"] = dict(wire.STATUS2_HEALTHY)
    return state


class Node:
    """The process's inside: one loop over a heap of what is due, the bus and the orders."""

    def __init__(self, orders: socket.socket) -> None:
        self.orders = orders
        self.bus = wire.open_bus([(c & 0x03FF_FFFF, 0x03FF_FFFF) for c in wire.COMMANDS])
        self.number = itertools.count()
        self.heap: list[tuple[float, int, Callable[[], None]]] = []
        self.life = self.counter = 0
        self.absent = {pedal_node.MESSAGE}
        self.heard = dict.fromkeys(CONTROLLERS, wire.ZERO_TORQUE)
        self.waiting: tuple[float, list] | None = None  # a script for after the next command
        self.epochs: dict[str, int] = {}
        self.heal()
        now = time.monotonic()
        for index, name in enumerate(wire.PERIODS_MS):
            self.again(name, now + 0.003 * index)
        self.at(now, self.beat)

    def heal(self) -> None:
        self.state = healthy()
        self.silent = set(self.absent)
        self.echo: dict[str, dict] = {pcu: {} for pcu in CONTROLLERS}
        self.life_mode: object = "toggle"
        self.followers: dict[str, list] = {}
        self.periods_ms = {**wire.PERIODS_MS, **dict.fromkeys(wire.IMU_AT_REST, IMU_CALM_MS)}

    # --- what is due ---

    def at(self, when: float, action: Callable[[], None]) -> None:
        heapq.heappush(self.heap, (when, next(self.number), action))

    def again(self, name: str, when: float) -> None:
        epoch = self.epochs[name] = self.epochs.get(name, 0) + 1

        def send_and_again() -> None:
            if self.epochs[name] != epoch:
                return
            period_s = self.periods_ms[name] / 1000
            if name not in self.silent:
                self.send(name)
            self.again(name, max(when + period_s, time.monotonic() + period_s / 2))

        self.at(when, send_and_again)

    def beat(self, due: float | None = None) -> None:
        now = time.monotonic()
        self.bus.send(wire.packed(wire.BEAT, b""))
        due = max((due or now) + BEAT_MS / 1000, now + BEAT_MS / 2000)
        self.at(due, lambda: self.beat(due))

    # --- frames ---

    def data(self, name: str, changes: dict) -> bytes:
        if name in wire.IMU_AT_REST:
            return wire.IMU_AT_REST[name]
        values = {**self.state[name], **changes}
        if name == "BMS_Status":
            return wire.bms_status(values, self.next_life(changes.get("life")))
        if name == "BMS_Temperatures":
            return wire.bms_temperatures(values)
        if name == "ARD2_SteeringWheel":
            return wire.steering_wheel(values)
        if name == pedal_node.MESSAGE:
            self.counter = (self.counter + values["step"]) % 16
            return pedal_node.frame(values, self.counter)
        if name.endswith("Status2"):
            return wire.status2(values)
        return wire.status1(values, self.echoed(name[:4]))

    def next_life(self, given: int | None = None) -> int:
        if given is not None:
            self.life = given
        elif self.life_mode == "toggle":
            self.life ^= 1
        return self.life

    def echoed(self, pcu: str) -> bytes:
        b1, throttle, brake = self.heard[pcu][:3]
        echo = self.echo[pcu]
        if "reverse" in echo:
            b1 = b1 & ~0x10 | echo["reverse"] << 4
        if "cut" in echo:
            b1 = b1 & ~0x80 | echo["cut"] << 7
        return bytes([b1, echo.get("throttle", throttle), brake])

    def send(self, name: str, changes: dict | None = None) -> None:
        self.put(wire.IDENTIFIERS[name], self.data(name, changes or {}))
        for delay_s, following in self.followers.get(name, []):
            self.at(time.monotonic() + delay_s, functools.partial(self.send_alone, name, following))

    def send_alone(self, name: str, changes: dict) -> None:
        self.put(wire.IDENTIFIERS[name], self.data(name, changes))

    def put(self, can_id: int, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self.bus.send(wire.packed(can_id, data))

    def put_raw(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):
            self.bus.send(frame)

    def commanded(self) -> None:
        try:
            frame = self.bus.recv(16)
        except OSError:
            return
        can_id, data = wire.unpacked(frame)
        if len(data) != 8 or data[3] == wire.INTRUDER_MARK:
            return
        for pcu, command in CONTROLLERS.items():
            if (can_id ^ command) & 0x03FF_FFFF == 0:
                self.heard[pcu] = data
                if f"{pcu}_Status2" not in self.silent:
                    self.send(f"{pcu}_Status2")
                if pcu == "PCU2" and self.waiting:
                    (after_s, items), self.waiting = self.waiting, None
                    self.schedule(time.monotonic() + after_s, items)

    # --- orders ---

    def schedule(self, base: float, items: list) -> None:
        """items: (after s, message, values) or (after s, None, whole CAN frame)."""
        for after_s, name, what in items:
            if name is None:
                self.at(base + after_s, functools.partial(self.put_raw, what))
            else:
                self.at(base + after_s, functools.partial(self.once, name, what))

    def once(self, name: str, values: dict) -> None:
        if period_ms := self.periods_ms.get(name):
            self.again(name, time.monotonic() + period_ms / 1000)
        self.send_alone(name, values)

    def obey(self, order: dict) -> None:
        getattr(self, f"do_{order.pop('do')}")(**order)

    def do_heal(self) -> None:
        was_silent = self.silent - self.absent
        changed = [name for name, values in healthy().items() if self.state[name] != values]
        followed = list(self.followers)
        self.heal()
        for name in {
            "BMS_Status",
            "PCU1_Status1",
            "PCU2_Status1",
            *was_silent,
            *changed,
            *followed,
        }:
            if name in wire.PERIODS_MS:
                self.once(name, {})

    def do_pedals(self, fitted: bool) -> None:
        """What a test has broken before stays so."""
        self.absent = set() if fitted else {pedal_node.MESSAGE}
        self.state[pedal_node.MESSAGE] = dict(pedal_node.RELEASED)
        self.silent = (self.silent - {pedal_node.MESSAGE}) | self.absent

    def do_set(self, message: str, values: dict, now: bool) -> None:
        self.state[message].update(values)
        if now:
            self.once(message, {})

    def do_silence(self, messages: list) -> None:
        self.silent |= set(messages)

    def do_resume(self, messages: list) -> None:
        self.silent -= set(messages)
        for name in messages:
            if name in wire.PERIODS_MS:
                self.once(name, {})

    def do_life(self, mode: str) -> None:
        self.life_mode = mode

    def do_echo(self, pcu: str, values: dict) -> None:
        self.echo[pcu] = values

    def do_follow(self, message: str, following: list) -> None:
        self.followers[message] = following

    def do_periods(self, periods_ms: dict) -> None:
        self.periods_ms.update(periods_ms)

    def do_script(self, items: list, after_tick_s: float | None) -> None:
        if after_tick_s is None:
            self.schedule(time.monotonic(), items)
        else:
            self.waiting = (after_tick_s, items)

    def do_reopen(self) -> None:
        self.bus.close()
        self.bus = wire.open_bus([(c & 0x03FF_FFFF, 0x03FF_FFFF) for c in wire.COMMANDS])

    # --- the loop ---

    def run(self) -> None:
        while True:
            timeout = max(0.0, self.heap[0][0] - time.monotonic()) if self.heap else 1.0
            ready, _, _ = select.select([self.bus, self.orders], [], [], timeout)
            if self.bus in ready:
                self.commanded()
            if self.orders in ready:
                order = self.orders.recv(1 << 16)
                if not order:
                    return
                self.obey(eval(order))  # ours alone: bytes and tuples as they are
                self.orders.send(b"done")
            while self.heap and self.heap[0][0] <= time.monotonic():
                with contextlib.suppress(OSError):
                    heapq.heappop(self.heap)[2]()


def main(orders: socket.socket) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with contextlib.suppress(PermissionError, OSError):
        os.nice(-5)
    Node(orders).run()
