"""A datagram socket in place of a CAN socket, where the kernel has no CAN.

Everything here reaches into python-can or into the gateway; what a source tree does not have is
left alone, so that an older and a newer tree run on the same socket.
"""

import logging
import socket
from typing import Any

from bench import on_import

_SOL_CAN_RAW = 101


class _StandIn(socket.socket):
    """An inherited datagram socket that forgives the options only CAN has."""

    def setsockopt(self, level: int, *rest: Any) -> None:
        if level != _SOL_CAN_RAW:
            super().setsockopt(level, *rest)


def for_python_can(descriptor: int) -> None:
    """Make python-can open this descriptor in place of a CAN socket."""

    def on_descriptor(names: dict[str, Any]) -> None:
        names["create_socket"] = lambda: _StandIn(fileno=descriptor)
        names["bind_socket"] = lambda *_: None

    on_import.change("can.interfaces.socketcan.socketcan", on_descriptor)
    logging.getLogger("can").setLevel(logging.CRITICAL)


def for_gateway() -> None:
    """Make the gateway see an interface, and its own frames that come back."""
    on_import.change("vcu_gateway.bus.interface", _there)
    on_import.change("vcu_gateway.bus.socketcan", _with_own_frames)


def _there(names: dict[str, Any]) -> None:
    there = names["Interface"](number=1, is_can=True, up=True, carrier=True, tx_queue_frames=0)
    setattr(names["Interfaces"], "look", lambda *_: there)  # noqa: B010 - mypy refuses to assign a method


def _with_own_frames(names: dict[str, Any]) -> None:
    """Only CAN sets MSG_CONFIRM on an own frame that comes back.

    Here the wire sends it back one byte too long, and the kernel's "cut off" flag stands in.
    """
    names.update(_FD_FRAME_BYTES=16, _MSG_CONFIRM=int(socket.MSG_TRUNC))
    vars(socket).update(MSG_CONFIRM=socket.MSG_TRUNC)
