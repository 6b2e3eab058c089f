#!/usr/bin/env python3
"""Write the vehicle's state to a file or to stdout, as CSV or JSON lines, with asyncio.

A value that may not be relied upon is left empty in CSV; JSON lines have it with its quality.
Updates that this program was too slow for are reported on stderr. It outlives the gateway:
where the connection ends, it waits for a new one.
"""

import argparse
import asyncio
import csv
import json
import logging
import sys
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import TextIO

from vcu_gateway.api.results import State, Update
from vcu_gateway.client import (
    ApiTimeoutError,
    AsyncClient,
    ClientError,
    DisconnectedError,
    UnreachableError,
)

RETRY_S = 1.0

log = logging.getLogger("logger")


class CsvLines:
    """One row for each update; the columns are those of the first."""

    def __init__(self, file: TextIO) -> None:
        self._writer = csv.writer(file)
        self._columns: list[str] = []

    def __call__(self, update: Update) -> None:
        """Write one row."""
        cells = _cells(update["state"])
        if not self._columns:
            self._columns = list(cells)
            self._writer.writerow([*self._columns, "lost"])
        row = ["" if (cell := cells.get(name)) is None else cell for name in self._columns]
        self._writer.writerow([*row, update["lost"]])


def _cells(state: State) -> dict[str, object]:
    cells: dict[str, object] = {"monotonic_ns": state["monotonic_ns"], "mode": state["mode"]}
    for controller, command in state["commands"].items():
        cells[f"{controller}.throttle_pct"] = command["throttle_pct"]
        cells[f"{controller}.brake_pct"] = command["brake_pct"]
    for message, latest in state["messages"].items():
        for name, signal in latest["signals"].items():
            good = signal["quality"] == "good"
            cells[f"{message}.{name}"] = signal["value"] if good else None
    return cells


class JsonLines:
    """One object for each update."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def __call__(self, update: Update) -> None:
        """Write one line."""
        line = {"lost": update["lost"], **update["state"]}
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")


async def updates_for_ever(
    client: AsyncClient, messages: list[str] | None, rate_hz: float
) -> AsyncGenerator[Update, None]:
    """Update after update, over as many connections as that takes."""
    while True:
        why = "the gateway ended the connection"
        try:
            async with client.subscribe(messages, rate_hz) as updates:
                async for update in updates:
                    yield update
        except (UnreachableError, DisconnectedError, ApiTimeoutError) as error:
            why = str(error)
        log.warning("%s; trying again", why)
        await asyncio.sleep(RETRY_S)


async def record(args: argparse.Namespace, file: TextIO) -> None:
    """Write updates, `count` of them or for ever."""
    write = CsvLines(file) if args.format == "csv" else JsonLines(file)
    client = AsyncClient(args.socket)
    written = lost = 0
    async with aclosing(updates_for_ever(client, args.message, args.rate_hz)) as updates:
        async for update in updates:
            write(update)
            written += 1
            if update["lost"]:
                lost += update["lost"]
                log.warning("%d updates lost, %d since the start", update["lost"], lost)
            if written == args.count:
                return


def main() -> int:
    """Parse the command line and write; 0 done or interrupted, 1 with a reason on stderr."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--socket", help="the gateway's socket; default: as the client finds it")
    parser.add_argument("--message", action="append", help="only this message; may be repeated")
    parser.add_argument("--rate-hz", type=float, default=10, help="0.1 to 50; default: %(default)s")
    parser.add_argument("--format", choices=["csv", "json"], default="csv")
    parser.add_argument("--output", help="a file, which is overwritten; default: stdout")
    parser.add_argument("--count", type=int, help="end after so many updates")
    args = parser.parse_args()
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    try:
        # A descriptor stays open where it is stdout's; a line goes out as soon as it is whole.
        target = args.output or sys.stdout.fileno()
        with open(target, "w", buffering=1, newline="", closefd=bool(args.output)) as file:
            asyncio.run(record(args, file))
    except KeyboardInterrupt:
        log.info("interrupted")
    except (ClientError, OSError) as error:
        log.error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
