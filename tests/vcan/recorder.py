"""Record every frame with the kernel's stamp: recorder.py CHANNEL FILE, until SIGTERM.

Knows nothing of the program under test. One line a frame: stamp in ns, identifier with
SocketCAN's flags, data.
"""

import signal
import socket
import struct
import sys

SO_TIMESTAMPNS = 35


def main(channel: str, path: str) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with (
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus,
        open(path, "w") as out,
    ):
        bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        bus.bind((channel,))
        print("ready", flush=True)
        while True:
            frame, ancillary, _, _ = bus.recvmsg(16, socket.CMSG_SPACE(16))
            can_id, length = struct.unpack_from("=IB", frame)
            seconds, nanoseconds = struct.unpack("@qq", ancillary[0][2])
            stamp_ns = seconds * 1_000_000_000 + nanoseconds
            out.write(f"{stamp_ns},{can_id:08X},{frame[8 : 8 + length].hex()}\n")
            out.flush()


main(*sys.argv[1:])
