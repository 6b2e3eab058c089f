"""Reading of small files in /proc and /sys."""

import os
from typing import NamedTuple


class Unreadable(NamedTuple):
    """A fact that could not be read, and why."""

    reason: str


def text(path: str) -> str | Unreadable:
    """The file's text, stripped."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return file.read().strip()
    except OSError as error:
        return unreadable(path, error)


def number(path: str) -> int | Unreadable:
    """The file's content as a natural number."""
    found = text(path)
    if isinstance(found, Unreadable):
        return found
    return int(found) if found.isdecimal() else Unreadable(f"{path} holds no number")


def fields(path: str) -> dict[str, str] | Unreadable:
    """The lines `name: value` of a file."""
    found = text(path)
    if isinstance(found, Unreadable):
        return found
    pairs = (line.partition(":") for line in found.splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}


def unreadable(what: str, error: OSError) -> Unreadable:
    return Unreadable(f"{what}: {error.strerror or error}")


def names(folder: str) -> list[str]:
    """Names in a folder, sorted; empty where it cannot be listed."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []
