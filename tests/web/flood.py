"""Requests as fast as they are answered: `python -m tests.web.flood PORT`, until stdin ends.

They come from many addresses, of which none is beyond its limit. It tells how many were answered.
"""

import http.client
import itertools
import os
import sys
import threading

THREADS = 6
ADDRESSES = 200
COUNT = itertools.count()
REQUESTS = (
    ("POST", "/api/actions/disarm"),
    ("POST", "/api/actions/estop"),
    ("GET", "/"),
    ("GET", "/api/session"),
    ("POST", "/api/session"),
    ("GET", "/api/history?signals=BMS_Status.SOC"),
)


def ask(port: int, first: int, answered: list[int], end: threading.Event) -> None:
    host = f"127.0.0.1:{port}"
    headers = {"Host": host, "Origin": f"http://{host}"}
    for method, path in itertools.islice(itertools.cycle(REQUESTS), first, None):
        if end.is_set():
            return
        source = (f"127.0.3.{1 + next(COUNT) % ADDRESSES}", 0)
        connection = http.client.HTTPConnection("127.0.0.1", port, 30, source)
        try:
            connection.request(method, path, headers=headers)
            connection.getresponse().read()
            answered[first] += 1
        except OSError:
            pass
        finally:
            connection.close()


def main(port: int) -> None:
    os.nice(10)  # behind what it floods
    answered, end = [0] * THREADS, threading.Event()
    threads = [
        threading.Thread(target=ask, args=(port, first, answered, end)) for first in range(THREADS)
    ]
    for thread in threads:
        thread.start()
    print("asking", flush=True)
    sys.stdin.read()
    end.set()
    for thread in threads:
        thread.join()
    print(sum(answered))


if __name__ == "__main__":
    main(int(sys.argv[1]))
