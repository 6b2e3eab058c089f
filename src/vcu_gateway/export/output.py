"""Output files, written under a temporary name and renamed when they are whole."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.files import sync


@contextlib.contextmanager
def written_file(path: Path, suffix: str = "") -> Iterator[Path]:
    """Temporary file beside `path`; takes its place at the end of the block.

    `suffix` is that of the temporary name. Raises UnavailableError where it cannot be written;
    nothing is left behind then.
    """
    with _told(path):
        handle, name = tempfile.mkstemp(suffix, f".{path.name}.partial-", path.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            sync(temporary)
            temporary.chmod(0o666 & ~_umask())
            temporary.replace(path)
            sync(path.parent)
        finally:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def written_text(path: Path) -> Iterator[TextIO]:
    """The same as an open text file, UTF-8, line ends as they are written."""
    with written_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as out:
        yield out


@contextlib.contextmanager
def written_folder(path: Path, suffix: str) -> Iterator[Path]:
    """Temporary folder beside `path`; takes its place at the end of the block.

    A folder that is there is replaced where it holds files with this suffix only.
    """
    with _told(path):
        if path.exists():
            _refuse_what_is_not_ours(path, suffix)
        temporary = Path(tempfile.mkdtemp("", f".{path.name}.partial-", path.parent))
        try:
            yield temporary
            for file in temporary.iterdir():
                sync(file)
            temporary.chmod(0o777 & ~_umask())
            _exchange(temporary, path)
            sync(path.parent)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _refuse_what_is_not_ours(path: Path, suffix: str) -> None:
    strange = "it is no folder"
    if path.is_dir():
        strange = ", ".join(sorted(one.name for one in path.iterdir() if one.suffix != suffix)[:3])
    if strange:
        remedy = f"only a folder of {suffix} files is replaced; name another with -o"
        raise UnavailableError(Problem(f"cannot be replaced: {strange}", str(path), remedy))


def _exchange(temporary: Path, path: Path) -> None:
    if not path.exists():
        temporary.rename(path)
        return
    old = Path(tempfile.mkdtemp("", f".{path.name}.old-", path.parent))
    path.rename(old / "folder")
    temporary.rename(path)
    shutil.rmtree(old)


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        what = f"cannot be written: {error.strerror or error}"
        raise UnavailableError(Problem(what, str(path))) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
