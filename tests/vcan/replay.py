"""Play a candump log in real time: replay.py CHANNEL LOG. Prints how many frames it sent."""

import re
import socket
import struct
import sys
import time

LINE = re.compile(r"\(([0-9.]+)\) \S+ ([0-9A-F]{8})#([0-9A-F]*)")
EFF_FLAG = 0x8000_0000


def main(channel: str, path: str) -> None:
    with open(path) as lines:
        frames = [match.groups() for line in lines if (match := LINE.match(line))]
    start_s, first_s = time.monotonic(), float(frames[0][0])
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind((channel,))
        for stamp, can_id, data in frames:
            wait_s = start_s + float(stamp) - first_s - time.monotonic()
            if wait_s > 0:
                time.sleep(wait_s)
            payload = bytes.fromhex(data)
            bus.send(struct.pack("=IB3x8s", int(can_id, 16) | EFF_FLAG, len(payload), payload))
    print(len(frames))


main(*sys.argv[1:])
