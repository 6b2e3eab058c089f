"""`vcu-gateway dbc`: generating, checking, and what it says of a bad definition."""

import os
from pathlib import Path
from typing import NamedTuple

import pytest
from click.testing import CliRunner

from vcu_gateway import cli
from vcu_gateway.cli import generate
from vcu_gateway.errors import GatewayError, UnavailableError
from vcu_gateway.protocol import packaged

REPOSITORY = packaged("vcu.yaml").resolve().parents[1]
GENERATED = ("dbc/vcu.dbc", "src/vcu_gateway/protocol/vcu_dbc.py")


class Ran(NamedTuple):
    code: int
    out: str
    err: str


def run(*arguments: str | Path) -> Ran:
    result = CliRunner().invoke(cli.group, ["dbc", *map(str, arguments)])
    if isinstance(result.exception, GatewayError):
        return Ran(result.exception.exit_code, result.stdout, str(result.exception))
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return Ran(result.exit_code, result.stdout, result.stderr)


@pytest.fixture
def tree(tmp_path, monkeypatch) -> Path:
    """A source tree in the current directory, with nothing generated yet."""
    (tmp_path / "dbc").mkdir()
    (tmp_path / "dbc/vcu.yaml").write_bytes(packaged("vcu.yaml").read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_file_is_generated_in_the_source_tree(tree):
    assert run() == Ran(0, "".join(f"{name} written\n" for name in GENERATED), "")
    for name in GENERATED:
        assert (tree / name).read_bytes() == (REPOSITORY / name).read_bytes()
    assert run() == Ran(0, "".join(f"{name} is current\n" for name in GENERATED), "")
    assert run("--check") == Ran(0, "", "")
    assert sorted(path.name for path in (tree / "dbc").iterdir()) == ["vcu.dbc", "vcu.yaml"]


def test_a_check_names_the_stale_file_shows_where_and_writes_nothing(tree):
    run()
    generated = (tree / "dbc/vcu.dbc").read_text(encoding="utf-8")
    stale = generated.replace("WheelSpeedFL : 16|16@1+ (0.001", "WheelSpeedFL : 16|16@1+ (0.002")
    (tree / "dbc/vcu.dbc").write_text(stale, encoding="utf-8")
    ran = run("--check")
    assert (ran.code, ran.out) == (1, "")
    first, *rest = ran.err.splitlines()
    assert first == "dbc/vcu.dbc is not what the definition says: run `vcu-gateway dbc`"
    assert '  - SG_ WheelSpeedFL : 16|16@1+ (0.002,0) [0|65.535] "km/h"  VCU' in rest
    assert '  + SG_ WheelSpeedFL : 16|16@1+ (0.001,0) [0|65.535] "km/h"  VCU' in rest
    assert len(rest) <= 20
    assert (tree / "dbc/vcu.dbc").read_text(encoding="utf-8") == stale


def test_a_check_names_every_missing_file_and_the_command_with_its_options(tree):
    (tree / "other.yaml").write_bytes((tree / "dbc/vcu.yaml").read_bytes())
    ran = run("--check", "--definition", "other.yaml", "--output", "a b.dbc")
    assert ran.code == 1
    mending = "vcu-gateway dbc --definition other.yaml --output 'a b.dbc'"
    named = [line for line in ran.err.splitlines() if not line.startswith("  ")]
    assert named == [
        f"a b.dbc is missing: run `{mending}`",
        f"src/vcu_gateway/protocol/vcu_dbc.py is missing: run `{mending}`",
    ]
    assert sorted(path.name for path in tree.iterdir()) == ["dbc", "other.yaml"]


def test_a_module_of_another_dbc_is_stale(tree):
    run()
    path = tree / "src/vcu_gateway/protocol/vcu_dbc.py"
    path.write_text(path.read_text().replace("factor=0.001", "factor=0.002", 1))
    ran = run("--check")
    assert ran.code == 1
    assert ran.err.startswith("src/vcu_gateway/protocol/vcu_dbc.py is not what the definition says")


def test_a_file_with_other_line_ends_is_stale(tree):
    run()
    path = tree / "dbc/vcu.dbc"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert run("--check").code == 1


def test_a_file_that_is_no_text_is_stale_and_replaced(tree):
    (tree / "dbc/vcu.dbc").write_bytes(b"\xff\xfe")
    assert run("--check").code == 1
    assert run().code == 0
    assert run("--check").code == 0


def test_a_symbolic_link_stays_one(tree):
    (tree / "real.dbc").write_text("")
    (tree / "dbc/vcu.dbc").symlink_to("../real.dbc")
    assert run().code == 0
    assert (tree / "dbc/vcu.dbc").is_symlink()
    assert (tree / "real.dbc").read_bytes() == (REPOSITORY / "dbc/vcu.dbc").read_bytes()


def test_the_mode_of_a_file_stays(tree):
    (tree / "dbc/vcu.dbc").write_text("")
    (tree / "dbc/vcu.dbc").chmod(0o600)
    run()
    assert (tree / "dbc/vcu.dbc").stat().st_mode & 0o777 == 0o600
    assert (tree / GENERATED[1]).stat().st_mode & 0o777 == 0o644


def test_a_bad_definition_is_reported_by_line_and_nothing_is_written(tree):
    path = tree / "dbc/vcu.yaml"
    text = path.read_text(encoding="utf-8").replace("id: 0x040AD079", "id: 0x240AD079")
    path.write_text(text, encoding="utf-8")
    number = 1 + text[: text.index("id: 0x240AD079")].count("\n")
    assert run() == Ran(
        os.EX_DATAERR,
        "",
        f"dbc/vcu.yaml:{number}: IMU_Acceleration.id: 0x240AD079 does not fit 29 bits",
    )
    assert not (tree / "dbc/vcu.dbc").exists()


def test_outside_the_source_tree_it_says_where_to_go(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    remedy = "run this in the source tree, or name the file with --definition"
    assert run() == Ran(os.EX_NOINPUT, "", f"dbc/vcu.yaml: is not here; {remedy}")
    ran = run("--definition", "other.yaml")
    assert (ran.code, ran.err.split(": ")[:2]) == (
        os.EX_NOINPUT,
        ["other.yaml", "there is no such file"],
    )


def test_a_place_that_cannot_be_written_is_reported(tree):
    (tree / "file").write_text("")
    ran = run("--output", "file/vcu.dbc")
    assert ran.code in {os.EX_NOINPUT, os.EX_UNAVAILABLE}
    assert ran.err == "file/vcu.dbc: cannot be read: Not a directory"
    ran = run("--output", "/proc/vcu.dbc")
    assert (ran.code, ran.err.split(":")[:2]) == (
        os.EX_UNAVAILABLE,
        ["/proc/vcu.dbc", " cannot be written"],
    )


def test_a_file_that_cannot_be_replaced_stays_and_nothing_is_left_beside_it(tmp_path):
    (tmp_path / "vcu.dbc").mkdir()
    with pytest.raises(UnavailableError, match=r"vcu\.dbc: cannot be written: Is a directory"):
        generate.replace(tmp_path / "vcu.dbc", "text")
    (tmp_path / "vcu.md").write_text("as it was")
    with pytest.raises(UnicodeEncodeError):
        generate.replace(tmp_path / "vcu.md", "a lone surrogate: \udc80")
    assert (tmp_path / "vcu.md").read_text() == "as it was"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["vcu.dbc", "vcu.md"]
