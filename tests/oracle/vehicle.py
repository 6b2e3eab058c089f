"""The handle to the scripted vehicle, which is a process of its own."""

import multiprocessing
import socket
from typing import Any

from tests.oracle import node, wire


class Vehicle:
    """The handle to that process; each order is done when the call returns."""

    def __init__(self) -> None:
        self.orders, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        context = multiprocessing.get_context("fork")
        self.process = context.Process(target=node.main, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.orders.settimeout(20)

    def _order(self, do: str, **arguments: Any) -> None:
        self.orders.send(repr({"do": do, **arguments}).encode())
        assert self.orders.recv(64) == b"done"

    def heal(self) -> None:
        self._order("heal")

    def pedals(self, *, fitted: bool) -> None:
        """Whether this vehicle has a pedal node; its pedals are released."""
        self._order("pedals", fitted=fitted)

    def set(self, message: str, *, now: bool = True, **values: Any) -> None:
        """Change signals for good; the frame that tells so is sent at once."""
        self._order("set", message=message, values=values, now=now)

    def silence(self, *messages: str) -> None:
        self._order("silence", messages=list(messages))

    def resume(self, *messages: str) -> None:
        self._order("resume", messages=list(messages))

    def life(self, mode: str) -> None:
        self._order("life", mode=mode)

    def echo(self, pcu: str, **values: int) -> None:
        self._order("echo", pcu=pcu, values=values)

    def follow(self, message: str, *following: tuple[float, dict]) -> None:
        """Every frame of a message is followed by others, each after so many seconds."""
        self._order("follow", message=message, following=list(following))

    def periods(self, **periods_ms: int) -> None:
        self._order("periods", periods_ms=periods_ms)

    def full_rate(self) -> None:
        """The inertial unit's too, until healed."""
        self._order(
            "periods", periods_ms={name: wire.PERIODS_MS[name] for name in wire.IMU_AT_REST}
        )

    def script(self, *items: tuple, after_tick_ms: float | None = None) -> None:
        """Frames at exact distances, from now or from so long after the next command."""
        after_tick_s = None if after_tick_ms is None else after_tick_ms / 1000
        self._order("script", items=list(items), after_tick_s=after_tick_s)

    def speeds(self, rpm1: int, rpm2: int | None = None) -> None:
        self.set("PCU1_Status2", now=False, MotorSpeed=rpm1)
        self.set("PCU2_Status2", now=False, MotorSpeed=rpm1 if rpm2 is None else rpm2)

    def reopen(self) -> None:
        self._order("reopen")

    def close(self) -> None:
        self.orders.close()
        self.process.kill()
        self.process.join(5)
