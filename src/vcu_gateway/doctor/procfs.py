"""Reading a small file of the kernel's, or why it cannot be read."""

import os
from typing import NamedTuple


class Unreadable(NamedTuple):
    """Could not be found out."""

    reason: str


def text(path: str) -> str | Unreadable:
    """The file's text without blanks around it."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return file.read().strip()
    except OSError as error:
        return refused(path, error)


def number(path: str) -> int | Unreadable:
    """The whole number that is all of the file."""
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


def refused(what: str, error: OSError) -> Unreadable:
    """An error as a reason."""
    return Unreadable(f"{what}: {error.strerror or error}")


def names(folder: str) -> list[str]:
    """What a folder holds, sorted; nothing where it cannot be listed."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []
