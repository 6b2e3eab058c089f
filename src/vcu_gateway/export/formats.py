"""Formats of an export: what each is written with, and into.

Output is written under a temporary name and renamed when it is whole. Where the library of an extra
is not installed, the error says how to install it.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TextIO

from vcu_gateway.errors import Problem, UnavailableError, extra_needed
from vcu_gateway.export import csv_table, html_report
from vcu_gateway.export.source import Selection, Source
from vcu_gateway.export.tables import Table, controller_tables, decision_tables, message_tables
from vcu_gateway.files import sync


def needed(package: str, extra: str) -> AbstractContextManager[None]:
    """Import of a library of a second environment; UnavailableError where it is not installed."""
    remedy = (
        "install it beside the gateway's environment, not into it: python3 -m venv ~/vcu-tools"
        f" && ~/vcu-tools/bin/pip install 'vcu-gateway[{extra}]' (docs/install.md)"
    )
    return extra_needed(f"writing {extra} needs the package", extra, package, remedy=remedy)


_TEXTS = {"csv": csv_table.write, "html": html_report.write}
FORMATS = (*_TEXTS, "mf4", "parquet", "mcap")


def check(kind: str) -> None:
    """UnavailableError where this format's library is not installed: before an hour is read."""
    if kind not in _TEXTS:
        _library_writer(kind)


def _library_writer(kind: str) -> Callable[[Source, Sequence[Table], Path], None]:
    """What writes a format that needs a library; UnavailableError where that is not installed."""
    if kind == "mf4":
        from vcu_gateway.export.mf4_file import write
    elif kind == "parquet":
        from vcu_gateway.export.parquet_folder import write
    else:
        from vcu_gateway.export.mcap_file import write
    return write


def tables_of(source: Source, selection: Selection) -> list[Table]:
    """Every table that is asked for, those of controllers and gateway first."""
    return [
        *controller_tables(source.store.rows, selection),
        *decision_tables(source.decisions, selection),
        *message_tables(source.store.rows.values(), selection),
    ]


def write(
    source: Source, tables: Sequence[Table], selection: Selection, kind: str, path: Path
) -> None:
    """Write the file or folder, whole or not at all."""
    if kind in _TEXTS:
        with written_text(path) as out:
            _TEXTS[kind](source, selection, out)
        return
    written = written_folder if kind == "parquet" else written_file
    with written(path, f".{kind}") as temporary:
        _library_writer(kind)(source, tables, temporary)


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
