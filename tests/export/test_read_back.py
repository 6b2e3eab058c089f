"""MF4, Parquet and MCAP, read by their own libraries: what cantools decodes, bit for bit."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.export.logs import START_NS, by_cantools, random_frames, write_log
from tests.export_libraries import PATIENCE_S, ROOT, export_folder, with_export_libraries

__all__ = ["export_folder"]
pytestmark = [pytest.mark.ci, pytest.mark.timeout(PATIENCE_S)]

FRAMES = random_frames(2600)
# Each prints JSON: attachments, and of each message stamps (ns) and columns, floats as hex.
HEAD = """
import json, sys
def exact(value):
    return value.hex() if isinstance(value, float) else int(value)
found, attached = {}, {}
"""
MF4 = """
from asammdf import MDF
with MDF(sys.argv[1]) as mdf:
    start_ns = round(mdf.header.start_time.timestamp() * 1e6) * 1000
    for number, group in enumerate(mdf.groups):
        name = group.channel_group.acq_name
        columns, stamps = {}, []
        for index, channel in enumerate(group.channels):
            if channel.name.lower() in ("time", "t"):
                continue
            named = channel.conversion is not None and channel.conversion.conversion_type == 7
            signal = mdf.get(group=number, index=index, raw=named, ignore_invalidation_bits=True)
            columns[channel.name] = [exact(one) for one in signal.samples.tolist()] \\
                if signal.samples.dtype.kind != "S" else [one.decode() for one in signal.samples]
            stamps = [round(one * 1e9) for one in signal.timestamps.tolist()]
            units = signal.unit
        found[name] = {"stamps": stamps, "columns": columns, "start": start_ns}
    for index in range(len(mdf.attachments)):
        data, path, _ = mdf.extract_attachment(index)
        attached[str(path)] = data.decode()
"""
PARQUET = """
from pathlib import Path
from pyarrow import parquet
for path in Path(sys.argv[1]).iterdir():
    table = parquet.read_table(path)
    columns = {
        name: [exact(one) if type(one) in (int, float) else one for one in table[name].to_pylist()]
        for name in table.column_names if name != "time"
    }
    stamps = table["time"].cast("int64").to_pylist()
    found[path.stem] = {"stamps": stamps, "columns": columns}
    kept = table.schema.metadata
    attached = {key.decode(): text.decode() for key, text in kept.items()}
    fields = [(field.name, field.metadata or {}) for field in table.schema]
    units = {name: kept.get(b"unit", b"").decode() for name, kept in fields}
    found[path.stem]["units"] = units
"""
MCAP = """
from mcap.reader import make_reader
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file)
    assert reader.get_summary().chunk_indexes
    latest = 0
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        assert message.log_time >= latest
        latest = message.log_time
        topic = found.setdefault(channel.topic[1:], {"stamps": [], "columns": {}})
        topic["stamps"].append(message.log_time)
        for name, value in json.loads(message.data).items():
            value = value if isinstance(value, str) else exact(value)
            topic["columns"].setdefault(name, []).append(value)
    attached = {one.name: one.data.decode() for one in reader.iter_attachments()}
"""
READERS = {"mf4": MF4, "parquet": PARQUET, "mcap": MCAP}


def run(folder: Path, *arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=with_export_libraries(folder),
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def read(folder: Path, kind: str, path: Path) -> dict:
    tail = '\nprint(json.dumps({"found": found, "attached": attached}))'
    answer: dict = json.loads(run(folder, "-c", HEAD + READERS[kind] + tail, path))
    return answer


@pytest.fixture(scope="module")
def exported(export_folder, tmp_path_factory) -> dict[str, dict]:
    """The same log in each format, read back."""
    folder = tmp_path_factory.mktemp("exported")
    log = write_log(folder / "drive.log", FRAMES)
    found = {}
    for kind in READERS:
        path = folder / f"drive.{kind}"
        run(export_folder, "-m", "vcu_gateway", "export", log, "--to", kind, "-o", path)
        found[kind] = read(export_folder, kind, path)
    return found


def expected_columns() -> dict[str, dict]:
    found = {}
    for name, rows in by_cantools(FRAMES).items():
        columns = {
            signal: [
                value.hex() if isinstance(value := values[signal], float) else int(value)
                for _, values in rows
            ]
            for signal in rows[0][1]
        }
        found[name] = {"stamps": [stamp for stamp, _ in rows], "columns": columns}
    return found


EXPECTED = expected_columns()


def as_float(value: object) -> object:
    """An int and the same float are one value: MF4 has no column for both."""
    return float.fromhex(value) if isinstance(value, str) and "0x" in value else value


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("message", EXPECTED)
def test_values_are_those_of_cantools_bit_for_bit(exported, kind, message):
    found = exported[kind]["found"][message]["columns"]
    for signal, values in EXPECTED[message]["columns"].items():
        assert [as_float(one) for one in found[signal]] == [as_float(one) for one in values]


@pytest.mark.parametrize("kind", ["parquet", "mcap"])
@pytest.mark.parametrize("message", EXPECTED)
def test_stamps_are_exact_to_the_nanosecond(exported, kind, message):
    assert exported[kind]["found"][message]["stamps"] == EXPECTED[message]["stamps"]


@pytest.mark.parametrize("message", EXPECTED)
def test_stamps_of_mf4_count_from_the_beginning(exported, message):
    since = [stamp - START_NS for stamp in EXPECTED[message]["stamps"]]
    assert exported["mf4"]["found"][message]["stamps"] == since


def test_the_begin_of_an_mf4_is_in_its_header(exported):
    start_ns = exported["mf4"]["found"]["BMS_Status"]["start"]
    assert abs(start_ns - START_NS) < 1000


@pytest.mark.parametrize("kind", READERS)
def test_the_dbc_is_attached(exported, kind):
    text = (ROOT / "dbc" / "vcu.dbc").read_text()
    assert exported[kind]["attached"]["vcu.dbc"].replace("\r\n", "\n") == text


def test_parquet_has_units_and_names_of_codes(exported):
    found = exported["parquet"]["found"]
    assert found["PCU1_Status2"]["units"]["MotorSpeed"] == "rpm"
    names = found["VCU_PCU1_Command"]["columns"]["PowerMode_name"]
    codes = found["VCU_PCU1_Command"]["columns"]["PowerMode"]
    assert set(zip(codes, names, strict=True)) == set(
        enumerate(("eco", "normal", "turbo", "safety"))
    )


@pytest.mark.parametrize("kind", READERS)
def test_commanded_stands_beside_what_the_controller_says(exported, kind):
    table = exported[kind]["found"]["PCU1"]
    names = list(table["columns"])
    assert names.index("Throttle_actual") > names.index("Throttle_commanded")
    commands = EXPECTED["VCU_PCU1_Command"]
    assert table["columns"]["Throttle_commanded"] == commands["columns"]["Throttle"]
    if kind == "parquet":
        answers = dict(
            zip(
                EXPECTED["PCU1_Status1"]["stamps"],
                EXPECTED["PCU1_Status1"]["columns"]["Throttle"],
                strict=True,
            )
        )
        latest = [
            max((one for one in answers if one <= stamp), default=None)
            for stamp in commands["stamps"]
        ]
        assert table["columns"]["Throttle_actual"] == [
            None if one is None else answers[one] for one in latest
        ]


@pytest.mark.ci
def test_what_exists_is_replaced_in_one_piece(export_folder, tmp_path):
    log = write_log(tmp_path / "drive.log", FRAMES[:100])
    for kind in READERS:
        path = tmp_path / f"out.{kind}"
        for _ in range(2):
            run(export_folder, "-m", "vcu_gateway", "export", log, "--to", kind, "-o", path)
    assert sorted(os.listdir(tmp_path)) == ["drive.log", "out.mcap", "out.mf4", "out.parquet"]
