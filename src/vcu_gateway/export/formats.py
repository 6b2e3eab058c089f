"""Formats of an export: what each is written with, and into.

Libraries of an extra: what is said where one is not installed.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from vcu_gateway.errors import extra_needed
from vcu_gateway.export.csv_table import written_file, written_folder, written_text
from vcu_gateway.export.source import Selection, Source
from vcu_gateway.export.tables import Table, controller_tables, decision_tables, message_tables


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
