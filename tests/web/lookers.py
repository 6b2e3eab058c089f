"""So many browsers that only read: `python -m tests.web.lookers PORT COUNT`, until stdin ends."""

import selectors
import socket
import sys


def main(port: int, count: int) -> None:
    readable = selectors.DefaultSelector()
    for _ in range(count):
        connection = socket.create_connection(("127.0.0.1", port))
        connection.sendall(f"GET /api/stream HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        connection.setblocking(False)
        readable.register(connection, selectors.EVENT_READ)
    readable.register(sys.stdin, selectors.EVENT_READ)
    print("looking", flush=True)
    while True:
        for key, _ in readable.select():
            if key.fileobj is sys.stdin:
                return
            assert isinstance(key.fileobj, socket.socket)
            key.fileobj.recv(65536)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
