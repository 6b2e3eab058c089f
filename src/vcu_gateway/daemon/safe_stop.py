"""Safe stop: a fresh process sends the safe frames after a kill, hang or crash of the gateway.

    python3 -I -S safe_stop.py FILE

systemd runs it as ExecStopPost. FILE is what the gateway left (see safe_frames.py). Nothing of
the gateway and no package is imported: it must work whatever broke, and at once.
"""

import os
import socket
import struct
import sys
import time

_ROUNDS = 5
_PERIOD_S = 0.050
_EFF_FLAG = 0x8000_0000
_CAN_RAW_FILTER = 1

_frame = struct.Struct("=IB3x8s")


def main() -> int:
    """Send the frames of the file, unless the gateway ended in order; 0 where all were sent."""
    if os.environ.get("SERVICE_RESULT", "") == "success":
        return 0
    try:
        channel, frames = read(sys.argv[1])
    except FileNotFoundError:
        print("no safe frames to send: the gateway had sent none, or ended in order")
        return 0
    except (OSError, ValueError, IndexError) as error:
        print(f"no safe frames to send: {error}")
        return 1
    try:
        sent = send(channel, frames)
    except OSError as error:
        print(f"{channel}: no safe frames sent: {error.strerror}")
        return 1
    print(f"{channel}: {sent} of {_ROUNDS * len(frames)} safe frames sent after the {_ending()}")
    return 0 if sent == _ROUNDS * len(frames) else 1


def _ending() -> str:
    words = (os.environ.get(name, "") for name in ("SERVICE_RESULT", "EXIT_CODE", "EXIT_STATUS"))
    return "gateway's end" + "".join(f" {word}" for word in words if word)


def read(path: str) -> tuple[str, list[bytes]]:
    """Interface and frames of a file, the frames as struct can_frame.

    Raises OSError, or ValueError where the file is torn.
    """
    with open(path, encoding="utf-8") as file:  # noqa: PTH123 - imports must be few
        channel, *lines = file.read().split()
    if not lines:
        raise ValueError(f"{path}: no frames in it")
    return channel, [_packed(line) for line in lines]


def _packed(line: str) -> bytes:
    can_id, separator, data = line.partition("#")
    payload = bytes.fromhex(data)
    if not separator or len(payload) != 8:
        raise ValueError(f"{line}: not an identifier, # and eight bytes")
    return _frame.pack(int(can_id, 16) | _EFF_FLAG, len(payload), payload)


def send(channel: str, frames: list[bytes]) -> int:
    """Send the frames five times, 50 ms apart; the number that the interface took.

    The first wait keeps half a period from what the gateway may have sent last.
    """
    sent = 0
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_FILTER, b"")  # nothing is received
        bus.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 0)  # little may wait, and grow old
        bus.bind((channel,))
        for _ in range(_ROUNDS):
            time.sleep(_PERIOD_S)
            sent += sum(_sent(bus, frame) for frame in frames)
    return sent


def _sent(bus: socket.socket, frame: bytes) -> bool:
    try:
        bus.send(frame, socket.MSG_DONTWAIT)
    except OSError:  # the queue is full or the interface down: the next round tries again
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
