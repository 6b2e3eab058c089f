"""A datagram socket in place of a CAN socket, where the kernel has no CAN.

Everything here reaches into python-can or into the gateway; what a source tree does not have is
left alone, so that an older and a newer tree run on the same socket.
"""

import logging
import socket
from typing import Any

_SOL_CAN_RAW = 101


class _StandIn(socket.socket):
    """An inherited datagram socket that forgives the options only CAN has."""

    def setsockopt(self, level: int, *rest: Any) -> None:
        if level != _SOL_CAN_RAW:
            super().setsockopt(level, *rest)


def for_python_can(descriptor: int) -> None:
    """Make python-can open this descriptor in place of a CAN socket."""
    from can.interfaces.socketcan import socketcan

    vars(socketcan).update(
        create_socket=lambda: _StandIn(fileno=descriptor),
        bind_socket=lambda *_: None,
    )
    logging.getLogger("can").setLevel(logging.CRITICAL)


def for_gateway() -> None:
    """Make the gateway see an interface, and its own frames that come back.

    Only CAN sets MSG_CONFIRM on them. Here the wire sends them back one byte too long, and the
    kernel's "cut off" flag stands in.
    """
    from vcu_gateway.bus import interface, socketcan

    there = interface.Interface(number=1, is_can=True, up=True, carrier=True, tx_queue_frames=0)
    setattr(interface.Interfaces, "look", lambda *_: there)  # noqa: B010 - mypy refuses to assign a method
    vars(socketcan).update(_FD_FRAME_BYTES=16)
    vars(socket).update(MSG_CONFIRM=socket.MSG_TRUNC)
