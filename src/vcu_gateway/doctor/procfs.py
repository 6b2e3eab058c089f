"""Reading a small file of the kernel's, or why it cannot be read."""

import os
from typing import NamedTuple


class Unread(NamedTuple):
    """Could not be found out."""

    reason: str


def text(path: str) -> str | Unread:
    """The file's text without blanks around it."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return file.read().strip()
    except OSError as error:
        return refused(path, error)


def number(path: str) -> int | Unread:
    """The whole number that is all of the file."""
    found = text(path)
    if isinstance(found, Unread):
        return found
    return int(found) if found.isdecimal() else Unread(f"{path} holds no number")


def fields(path: str) -> dict[str, str] | Unread:
    """The lines `name: value` of a file."""
    found = text(path)
    if isinstance(found, Unread):
        return found
    pairs = (line.partition(":") for line in found.splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}


def refused(what: str, error: OSError) -> Unread:
    """An error as a reason."""
    return Unread(f"{what}: {error.strerror or error}")


def names(folder: str) -> list[str]:
    """What a folder holds, sorted; nothing where it cannot be listed."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []
