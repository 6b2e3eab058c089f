"""Golden drives from the command line: check, accept, list; scripts/golden calls it.

check replays every drive and says what turned out otherwise: drive, tick, field, before, after.
accept takes what the core does now as right: it records the drives anew and writes the report of
what that changed to tests/golden/CHANGES.md, which belongs into the same commit. Recording twice
gives the same bytes.
"""

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.golden.every import DRIVES
from tests.golden.recording import FOLDER, contents, link_dbc, record
from tests.golden.replayed import Replayed, replay
from vcu_gateway.recording import layout

CHANGES = FOLDER.parent / "CHANGES.md"
HEADING = "# What the golden drives were last accepted for\n"
NOTE = """
Written by `make golden-accept`: each golden drive that this commit's core makes otherwise, with its
first difference, and each that was recorded anew. Before is the recording of the commit before.
"""


def progress(names: list[str]) -> Iterator[str]:
    """The names, told on a terminal as their turn comes."""
    for number, name in enumerate(names, start=1):
        if sys.stderr.isatty():
            print(f"\r\033[K{number} of {len(names)}: {name}", end="", file=sys.stderr, flush=True)
        yield name
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)


def differing() -> list[Replayed]:
    """The drives whose recording turns out otherwise."""
    there = [name for name in DRIVES if (FOLDER / name / layout.DRIVE_FILE).exists()]
    replays = [replay(DRIVES[name]) for name in progress(there)]
    return [one for one in replays if not one.is_equal]


def check() -> int:
    """Replay; 1 and the report where something is otherwise."""
    found = differing()
    for one in found:
        print("\n".join(one.lines()))
    if found:
        print(f"{len(found)} of {len(DRIVES)} golden drives differ; if that is meant:"
              " make golden-accept, and commit what it writes")  # fmt: skip
        return 1
    print(f"{len(DRIVES)} golden drives: every byte is the same")
    return 0


def accept() -> int:
    """Record anew what is otherwise, and write the report; the drives' names are told."""
    report = [line for one in differing() for line in one.lines()]
    changed = [name for name in progress(list(DRIVES)) if _recorded_otherwise(name)]
    gone = sorted(path.name for path in FOLDER.iterdir() if path.name not in DRIVES)
    for name in gone:
        shutil.rmtree(FOLDER / name)
    if not (changed or gone):
        print("nothing to accept: every byte is the same")
        return 0
    told = [
        *report,
        *(f"{name}: recorded anew" for name in changed),
        *(f"{name}: gone" for name in gone),
    ]
    CHANGES.write_text(
        f"{HEADING}{NOTE}\n```text\n" + "\n".join(told) + "\n```\n", encoding="utf-8"
    )
    print("\n".join(told))
    print(f"written: {os.path.relpath(CHANGES)}; commit it with {os.path.relpath(FOLDER)}")
    return 0


def _recorded_otherwise(name: str) -> bool:
    """Record it; True where that is another recording than the one there, which it replaces."""
    with tempfile.TemporaryDirectory() as folder:
        new = record(DRIVES[name], Path(folder))
        old = FOLDER / name
        if old.is_dir() and contents(old) == contents(new):
            return False
        shutil.rmtree(old, ignore_errors=True)
        old.parent.mkdir(exist_ok=True)
        shutil.move(new, old)
        link_dbc(old, DRIVES[name])
        return True


def show() -> int:
    """List the drives."""
    for name, drive in DRIVES.items():
        print(f"{name:32} {drive.title}")
    return 0


VERBS = {"check": check, "accept": accept, "list": show}


def main() -> int:
    layout_of_help = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("golden", description=__doc__, formatter_class=layout_of_help)
    parser.add_argument("verb", choices=VERBS)
    return VERBS[parser.parse_args().verb]()


if __name__ == "__main__":
    sys.exit(main())
