"""MCAP, written by mcap: a topic a table, with messages in JSON and an index."""

import heapq
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from vcu_gateway.export.formats import needed
from vcu_gateway.export.source import Source
from vcu_gateway.export.tables import Channel, Table

with needed("mcap", "mcap"):
    from mcap.writer import Writer

_TYPES = {"int": "integer", "float": "number", "text": "string"}


def write(source: Source, tables: Sequence[Table], path: Path) -> None:
    """Write every row as a message, in the order of the stamps."""
    # Of a file without a buffer the writer would keep the end to itself.
    with path.open("wb", buffering=1 << 20) as file:
        writer = Writer(file)
        writer.start(profile="", library="vcu-gateway")
        topics = [_register(writer, table) for table in tables]
        for name, contents in source.attachments.items():
            writer.add_attachment(source.start_ns, source.start_ns, name, "text/plain", contents)
        writer.add_metadata("recording", {"name": source.title})
        rows = heapq.merge(*map(_messages, topics, tables))
        for stamp_ns, topic, text in rows:
            writer.add_message(topic, stamp_ns, text.encode(), stamp_ns)
        writer.finish()


def _register(writer: Any, table: Table) -> int:
    properties = {channel.name: _property(channel) for channel in table.channels}
    schema = {"type": "object", "description": table.comment, "properties": properties}
    schema_id = writer.register_schema(table.name, "jsonschema", json.dumps(schema).encode())
    topic: int = writer.register_channel(f"/{table.name}", "json", schema_id)
    return topic


def _property(channel: Channel) -> dict[str, Any]:
    texts = [channel.comment, f"in {channel.unit}" if channel.unit else ""]
    if channel.names:
        texts.append(", ".join(f"{value} {name}" for value, name in channel.names.items()))
    described = {"type": _TYPES[channel.kind], "description": "; ".join(filter(None, texts))}
    return {**described, "unit": channel.unit} if channel.unit else described


def _messages(topic: int, table: Table) -> Iterator[tuple[int, int, str]]:
    keys = [f"{json.dumps(channel.name)}:" for channel in table.channels]
    kinds = [channel.kind for channel in table.channels]
    for chunk in table.chunks():
        for stamp_ns, values in zip(chunk.times_ns, zip(*chunk.columns, strict=True), strict=True):
            fields = [
                key + (json.dumps(value) if kind == "text" else repr(value))
                for key, value, kind in zip(keys, values, kinds, strict=True)
                if kind != "float" or not math.isnan(value)
            ]
            yield stamp_ns, topic, f"{{{','.join(fields)}}}"
