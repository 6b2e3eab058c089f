"""MF4 (ASAM MDF 4.10), written by asammdf: a channel group a table, raw codes and conversions."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vcu_gateway.export.formats import needed
from vcu_gateway.export.source import Source
from vcu_gateway.export.tables import Channel, Column, Table
from vcu_gateway.units import NS_PER_S

with needed("asammdf", "mf4"):
    from asammdf import MDF, Signal
import numpy

_VERSION = "4.10"
_DEFLATED_TRANSPOSED = 2


def write(source: Source, tables: Sequence[Table], path: Path) -> None:
    """Write every table; stamps count from the source's beginning, which stands in the header."""
    with MDF(version=_VERSION) as mdf:
        mdf.header.start_time = datetime.fromtimestamp(source.start_ns / NS_PER_S, UTC)
        mdf.header.comment = f"{source.title}, exported by vcu-gateway"
        for name, contents in source.attachments.items():
            mdf.attach(contents, file_name=name, mime="text/plain")
        for table in tables:
            _append(mdf, table, source.start_ns)
        mdf.save(path, overwrite=True, compression=_DEFLATED_TRANSPOSED)


def _append(mdf: Any, table: Table, start_ns: int) -> None:
    chunks, types = table.raw_chunks or table.chunks, _types(table)
    group = None
    for chunk in chunks():
        stamps_ns = numpy.frombuffer(chunk.times_ns, numpy.int64)
        times_s = (stamps_ns - start_ns) / NS_PER_S
        columns = [
            _samples(column, kind) for column, kind in zip(chunk.columns, types, strict=True)
        ]
        if group is not None:
            mdf.extend(group, [(times_s, None), *((column, None) for column in columns)])
            continue
        signals = [
            _signal(table, channel, column, times_s)
            for channel, column in zip(table.channels, columns, strict=True)
        ]
        group = mdf.append(
            signals, acq_name=table.name, comment=table.comment, common_timebase=True
        )


def _types(table: Table) -> list[str]:
    """Type of each column, as numpy names it; a text is as wide as the longest."""
    types = [_type(channel) for channel in table.channels]
    if "text" in (channel.kind for channel in table.channels):
        for chunk in table.chunks():
            for index, column in enumerate(chunk.columns):
                width = max(len(str(text).encode()) for text in column)
                types[index] = max(types[index], f"S{width:09d}")
    return types


def _type(channel: Channel) -> str:
    if channel.raw_bits:
        width = next(bits for bits in (8, 16, 32, 64) if bits >= abs(channel.raw_bits))
        return f"int{width}" if channel.raw_bits < 0 else f"uint{width}"
    return {"int": "int8", "float": "float64", "text": "S000000001"}[channel.kind]


def _samples(column: Column, kind: str) -> Any:
    if kind.startswith("S"):
        return numpy.array([str(text).encode() for text in column], kind)
    return numpy.array(column, kind)


def _signal(table: Table, channel: Channel, samples: Any, times_s: Any) -> Any:
    return Signal(
        samples=samples,
        timestamps=times_s,
        name=channel.name,
        unit=channel.unit,
        comment=channel.comment,
        conversion=_conversion(channel),
        display_names={f"{table.name}.{channel.name}": "display_name"},
        encoding="utf-8" if channel.kind == "text" else None,
    )


def _conversion(channel: Channel) -> dict[str, Any] | None:
    if channel.names:
        texts: dict[str, Any] = {"default": b""}
        for index, (value, name) in enumerate(channel.names.items()):
            texts |= {f"val_{index}": value, f"text_{index}": name.encode()}
        return texts
    if channel.raw_bits and (channel.factor, channel.offset) != (1.0, 0.0):
        return {"a": channel.factor, "b": channel.offset}
    return None
