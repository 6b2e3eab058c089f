"""Formats of an export: what each is written with, and into.

Output is written under a temporary name and renamed when it is whole. Where the library of an extra
is not installed, the error says how to install it.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TextIO

from vcu_gateway.errors import Problem, UnavailableError, extra_needed
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


FORMATS = ("csv", "html", "mf4", "parquet", "mcap")


def check(kind: str) -> None:
    """UnavailableError where this format's library is not installed: before an hour is read."""
    if kind == "mf4":
        from vcu_gateway.export import mf4_file  # noqa: F401
    elif kind == "parquet":
        from vcu_gateway.export import parquet_folder  # noqa: F401
    elif kind == "mcap":
        from vcu_gateway.export import mcap_file  # noqa: F401


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
    if kind == "csv":
        from vcu_gateway.export import csv_table

        with written_text(path) as out:
            csv_table.write(source, selection, out)
    elif kind == "html":
        from vcu_gateway.export import html_report

        with written_text(path) as out:
            html_report.write(source, selection, out)
    elif kind == "parquet":
        from vcu_gateway.export import parquet_folder

        with written_folder(path, parquet_folder.SUFFIX) as folder:
            parquet_folder.write(source, tables, folder)
    else:
        _write_binary(source, tables, kind, path)


def _write_binary(source: Source, tables: Sequence[Table], kind: str, path: Path) -> None:
    with written_file(path, f".{kind}") as temporary:
        if kind == "mf4":
            from vcu_gateway.export import mf4_file

            mf4_file.write(source, tables, temporary)
        else:
            from vcu_gateway.export import mcap_file

            mcap_file.write(source, tables, temporary)


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
