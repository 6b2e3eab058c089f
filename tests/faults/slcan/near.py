"""Record frames at an adapter's interface, which may come and go: near.py FILE INTERFACE.

What the gateway sends is stamped when the kernel takes it: the wire would show when the adapter
passed it on. The file is as of tests/vcan/recorder.py; other interfaces are left out.
"""

import socket
import struct
import sys

SO_TIMESTAMPNS = 35


def main(path: str, interface: str) -> None:
    with (
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus,
        open(path, "w") as out,
    ):
        bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        bus.bind(("",))
        print("ready", flush=True)
        while True:
            frame, ancillary, _, address = bus.recvmsg(16, socket.CMSG_SPACE(16))
            if address[0] != interface:
                continue
            can_id, length = struct.unpack_from("=IB", frame)
            seconds, nanoseconds = struct.unpack("@qq", ancillary[0][2])
            stamp_ns = seconds * 1_000_000_000 + nanoseconds
            out.write(f"{stamp_ns},{can_id:08X},{frame[8 : 8 + length].hex()}\n")
            out.flush()


main(*sys.argv[1:])
