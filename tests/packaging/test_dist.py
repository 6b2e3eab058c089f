"""Wheel and sdist: they install and run far from the source tree."""

import hashlib
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.packaging.built import BIN
from vcu_gateway import __version__

pytestmark = pytest.mark.timeout(600)
NAME = f"vcu_gateway-{__version__}"
UV: list[str | Path] = [BIN / "uv", "--quiet", "--no-config"]


@pytest.fixture(scope="module")
def wheel(dist: Path) -> Path:
    return dist / f"{NAME}-py3-none-any.whl"


@pytest.fixture(scope="module")
def rebuilt(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel made from the sdist, in a place that git knows nothing of."""
    place = tmp_path_factory.mktemp("from the sdist")
    with tarfile.open(dist / f"{NAME}.tar.gz") as archive:
        # Python 3.11.2, which is Debian 12's, does not take it as an argument.
        archive.extraction_filter = getattr(tarfile, "data_filter", None)
        archive.extractall(place)
    subprocess.run(
        [BIN / "hatchling", "build", "-t", "wheel", "-d", place],
        cwd=place / NAME,
        check=True,
        capture_output=True,
    )
    return place / f"{NAME}-py3-none-any.whl"


@pytest.fixture(scope="module")
def installed(rebuilt: Path, tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """bin of an environment with the wheel and what is locked, nothing else."""
    place = tmp_path_factory.mktemp("installed")
    subprocess.run([*UV, "venv", "--python", BIN / "python", place / "venv"], check=True)
    install: list[str | Path] = [*UV, "pip", "install", "--python", place / "venv/bin/python"]
    locked: list[str | Path] = [
        "--require-hashes",
        "--only-binary",
        ":all:",
        "-r",
        tree / "requirements.lock",
    ]
    subprocess.run([*install, *locked], check=True)
    subprocess.run([*install, "--no-deps", rebuilt], check=True)
    return place / "venv" / "bin"


@pytest.fixture
def run(installed: Path, tmp_path: Path):
    """Run the program in an empty folder; its output."""

    def run(*words: str) -> str:
        done = subprocess.run(
            [installed / "vcu-gateway", *words], cwd=tmp_path, capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    return run


def contents(wheel: Path) -> dict[str, str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: hashlib.sha256(archive.read(name)).hexdigest() for name in archive.namelist()}


def test_the_wheel_holds_real_files_where_the_tree_has_links(wheel, tree):
    with zipfile.ZipFile(wheel) as archive:
        for name, original in (
            ("gateway.yaml", "config/gateway.yaml"),
            ("vcu.dbc", "dbc/vcu.dbc"),
            ("vcu.yaml", "dbc/vcu.yaml"),
        ):
            inside = archive.read(f"vcu_gateway/data/{name}")
            assert inside == (tree / original).read_bytes()


def test_the_sdist_makes_the_same_wheel(wheel, rebuilt):
    assert contents(rebuilt) == contents(wheel)


def test_every_module_of_the_tree_is_in_the_wheel(wheel, tree):
    modules = {str(path.relative_to(tree / "src")) for path in (tree / "src").rglob("*.py")}
    assert {name for name in contents(wheel) if name.endswith(".py")} == modules


def test_it_tells_its_version(run):
    assert run("version").startswith(f"vcu-gateway {__version__}\n")


def test_it_comes_with_a_configuration_that_it_accepts(run, installed):
    (packaged,) = installed.parent.glob("lib/*/site-packages/vcu_gateway/data/gateway.yaml")
    assert run("check-config", "-c", str(packaged)).startswith(f"{packaged}: valid")


def test_it_makes_the_dbc_that_it_comes_with(run, installed, tmp_path):
    (data,) = installed.parent.glob("lib/*/site-packages/vcu_gateway/data")
    outputs = ("--output", "vcu.dbc", "--module", "vcu_dbc.py")
    names = ("--definition", str(data / "vcu.yaml"), *outputs)
    run("dbc", *names)
    assert (tmp_path / "vcu.dbc").read_bytes() == (data / "vcu.dbc").read_bytes()
    module = data.parent / "protocol" / "vcu_dbc.py"
    assert (tmp_path / "vcu_dbc.py").read_bytes() == module.read_bytes()
    run("dbc", "--check", *names)


def test_it_prints_its_schema(run):
    assert '"$schema"' in run("schema")


def test_it_offers_the_demonstration(run):
    assert "Show gateway and simulated vehicle together" in run("demo", "--help")
