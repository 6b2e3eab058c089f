"""Record frames with the kernel's stamp: recorder.py FILE CHANNEL [IDENTIFIER]..., hexadecimal.

An empty CHANNEL is every CAN interface, those that come later too, on one socket that outlives
a link that is down or deleted; =NAME is of these the one of this name, which may come and go.
Without identifiers every frame. Knows nothing of the program under test. One line a frame: stamp
in ns, identifier with SocketCAN's flags, data.
"""

import contextlib
import signal
import socket
import struct
import sys

SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
EFF, EFF_MASK = 0x8000_0000, 0xDFFF_FFFF


def main(path: str, channel: str, *identifiers: str) -> None:
    only = channel[1:] if channel.startswith("=") else ""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with (
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus,
        open(path, "w") as out,
    ):
        bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        with contextlib.suppress(OSError):  # beyond the machine's limit, where that is allowed
            bus.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 22)
        if identifiers:
            wanted = [struct.pack("=II", EFF | int(one, 16), EFF_MASK) for one in identifiers]
            bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"".join(wanted))
        bus.bind(("" if only else channel,))
        print("ready", flush=True)
        while True:
            frame, ancillary, _, address = bus.recvmsg(16, socket.CMSG_SPACE(16))
            if only and address[0] != only:
                continue
            can_id, length = struct.unpack_from("=IB", frame)
            seconds, nanoseconds = struct.unpack("@qq", ancillary[0][2])
            stamp_ns = seconds * 1_000_000_000 + nanoseconds
            out.write(f"{stamp_ns},{can_id:08X},{frame[8 : 8 + length].hex()}\n")
            out.flush()


main(*sys.argv[1:])
