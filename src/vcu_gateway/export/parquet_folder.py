"""Parquet, written by pyarrow: a folder with a file for each table."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vcu_gateway.export.formats import needed
from vcu_gateway.export.source import Source
from vcu_gateway.export.tables import Channel, Column, Table

with needed("pyarrow", "parquet"):
    import pyarrow
    from pyarrow import parquet

_CODEC = "zstd"


def write(source: Source, tables: Sequence[Table], path: Path) -> None:
    """Write a file for each table into the folder `path`; stamps are UTC, in nanoseconds."""
    attached = {name.encode(): contents for name, contents in source.attachments.items()}
    for table in tables:
        schema = pyarrow.schema(
            [_time(), *(field for channel in table.channels for field in _fields(channel))],
            metadata={b"recording": source.title.encode(), b"comment": table.comment.encode()}
            | attached,
        )
        file = path / f"{table.name}.parquet"
        with parquet.ParquetWriter(file, schema, compression=_CODEC) as writer:
            for chunk in table.chunks():
                columns = [pyarrow.array(chunk.times_ns, pyarrow.int64()).cast(_time().type)]
                for channel, column in zip(table.channels, chunk.columns, strict=True):
                    columns += _arrays(channel, column)
                writer.write_table(pyarrow.table(columns, schema=schema))


def _time() -> Any:
    return pyarrow.field("time", pyarrow.timestamp("ns", "UTC"), nullable=False)


def _fields(channel: Channel) -> list[Any]:
    """The channel and, of an enumeration, a second column with the names of its values."""
    kinds = {"int": pyarrow.int64(), "float": pyarrow.float64(), "text": pyarrow.string()}
    metadata = {"unit": channel.unit, "comment": channel.comment}
    if channel.names:
        metadata["names"] = json.dumps(channel.names)
    fields = [pyarrow.field(channel.name, kinds[channel.kind], metadata=metadata)]
    if channel.names:
        named = pyarrow.dictionary(pyarrow.int16(), pyarrow.string())
        fields.append(pyarrow.field(f"{channel.name}_name", named))
    return fields


def _arrays(channel: Channel, column: Column) -> list[Any]:
    """A NaN, which stands for no value, becomes null."""
    first, *named = _fields(channel)
    arrays = [pyarrow.array(column, first.type, from_pandas=True)]
    if named:
        texts = [channel.names.get(value) for value in column]  # type: ignore[call-overload]
        arrays.append(
            pyarrow.array(texts, pyarrow.string()).dictionary_encode().cast(named[0].type)
        )
    return arrays
