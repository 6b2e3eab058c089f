"""What is in the Debian package."""

import base64
import csv
import hashlib
import io
import re
import subprocess
import tempfile
from pathlib import PurePosixPath

import pytest

from tests.packaging.built import HOME, epoch_s
from vcu_gateway import __version__

pytestmark = pytest.mark.timeout(1200)  # the first test builds, and may install what builds

UNITS = (
    "vcu-gateway.service",
    "vcu-gateway@.service",
    "vcu-gateway-exporter.service",
    "vcu-gateway-recorder.service",
    "vcu-gateway-web.service",
    "vcu-gateway-pedals.service",
)
PROGRAMS = {
    f"{HOME}/bin/{name}" for name in ("vcu-gateway", "vcu-gateway-recorder", "vcu-gateway-pedals")
} | {f"{HOME}/is-active"}
FROM_THE_TREE = {
    "etc/vcu-gateway/gateway.yaml": "config/gateway.yaml",
    "{units}/vcu-gateway.service": "systemd/vcu-gateway.service",
    "{units}/vcu-gateway@.service": "systemd/vcu-gateway@.service",
    "{units}/vcu-gateway-exporter.service": "systemd/vcu-gateway-exporter.service",
    "{units}/vcu-gateway-recorder.service": "systemd/vcu-gateway-recorder.service",
    "{units}/vcu-gateway-web.service": "systemd/vcu-gateway-web.service",
    "{units}/vcu-gateway-pedals.service": "systemd/vcu-gateway-pedals.service",
    "{units}/vcu-gateway-recorder.socket": "systemd/vcu-gateway-recorder.socket",
    "{rules}/60-vcu-gateway-pedals.rules": "systemd/60-vcu-gateway-pedals.rules",
    "usr/lib/sysusers.d/vcu-gateway.conf": "systemd/sysusers.conf",
    "usr/lib/tmpfiles.d/vcu-gateway.conf": "systemd/tmpfiles.conf",
    "usr/share/vcu-gateway/network/can0.network": "systemd/can0.network",
    "usr/share/vcu-gateway/network/10-can0.link": "systemd/10-can0.link",
    "usr/share/vcu-gateway/network/vcan0.netdev": "systemd/vcan0.netdev",
    "usr/share/vcu-gateway/network/vcan0.network": "systemd/vcan0.network",
    "usr/share/vcu-gateway/examples/10-vehicle.conf.example": (
        "systemd/vcu-gateway.service.d/10-vehicle.conf.example"
    ),
    "usr/share/vcu-gateway/examples/bench-vcan0.yaml": "config/bench-vcan0.yaml",
    "usr/share/vcu-gateway/examples/tuning.yaml": "config/examples/tuning.yaml",
    "usr/share/vcu-gateway/examples/converters.yaml": "config/examples/converters.yaml",
    "usr/share/vcu-gateway/examples/joystick.yaml": "config/examples/joystick.yaml",
    "usr/share/vcu-gateway/examples/pedals.yaml": "config/examples/pedals.yaml",
    "usr/share/vcu-gateway/examples/pedals.dbc": "config/examples/pedals.dbc",
    "usr/share/vcu-gateway/examples/scenarios/bms-silent.yaml": "config/scenarios/bms-silent.yaml",
    "usr/share/doc/vcu-gateway/README.md": "README.md",
    "usr/share/doc/vcu-gateway/SECURITY.md": "SECURITY.md",
    "usr/share/doc/vcu-gateway/docs/safety.md": "docs/safety.md",
    "usr/share/doc/vcu-gateway/docs/examples/control_loop.py": "docs/examples/control_loop.py",
    "{site}/vcu_gateway/data/gateway.yaml": "config/gateway.yaml",
    "{site}/vcu_gateway/data/pedals.yaml": "config/examples/pedals.yaml",
    "{site}/vcu_gateway/data/pedals.dbc": "config/examples/pedals.dbc",
    "{site}/vcu_gateway/data/vcu.dbc": "dbc/vcu.dbc",
    "{site}/vcu_gateway/data/vcu.yaml": "dbc/vcu.yaml",
}
COMPLETIONS = (
    "usr/share/bash-completion/completions/vcu-gateway",
    "usr/share/zsh/vendor-completions/_vcu-gateway",
    "usr/share/fish/vendor_completions.d/vcu-gateway.fish",
)


def test_its_version_and_architecture_are_those_of_the_tree_the_release_and_the_machine(deb):
    machine = subprocess.check_output(["dpkg", "--print-architecture"], text=True).strip()
    assert deb.field("Architecture") == machine
    assert deb.field("Version") == f"{__version__}-1~deb{deb.release.number}u1"


def test_it_depends_on_the_python_that_its_libraries_are_for(deb):
    major, _, minor = deb.release.python.partition(".")
    wanted = {f"python3 (>= {major}.{minor})", f"python3 (<< {major}.{int(minor) + 1})"}
    assert wanted <= set(deb.field("Depends").split(", "))


@pytest.mark.parametrize("inside", FROM_THE_TREE)
def test_it_holds_the_file_of_the_tree(deb, tree, inside):
    assert deb.contents[deb.place(inside)] == (tree / FROM_THE_TREE[inside]).read_bytes()


@pytest.mark.parametrize("inside", COMPLETIONS)
def test_it_completes_in_every_shell(deb, inside):
    assert "_VCU_GATEWAY_COMPLETE=" in deb.text(inside)


def test_everything_belongs_to_root_and_is_readable_by_all_and_writable_by_root_alone(deb):
    modes = {
        name: (member.uname, member.gname, member.mode) for name, member in deb.members.items()
    }
    expected = {
        name: ("root", "root", 0o755 if member.isdir() or name in PROGRAMS else 0o644)
        for name, member in deb.members.items()
        if not member.issym()
    }
    assert {name: modes[name] for name in expected} == expected


def test_every_time_is_that_of_the_commit(deb):
    assert {member.mtime for member in deb.members.values()} == {epoch_s()}


def test_the_links_are_those_of_a_virtual_environment_of_the_systems_python(deb):
    links = {name: member.linkname for name, member in deb.members.items() if member.issym()}
    assert links == {
        "usr/bin/vcu-gateway": "../lib/vcu-gateway/bin/vcu-gateway",
        "usr/bin/vcu-gateway-pedals": "../lib/vcu-gateway/bin/vcu-gateway-pedals",
        "usr/bin/vcu-gateway-recorder": "../lib/vcu-gateway/bin/vcu-gateway-recorder",
        f"{HOME}/bin/python3": "../../../bin/python3",
        f"{HOME}/safe_stop.py": deb.place("{site}/vcu_gateway/daemon/safe_stop.py").removeprefix(
            f"{HOME}/"
        ),
    }
    assert "home = /usr/bin\n" in deb.text(f"{HOME}/pyvenv.cfg")
    first = deb.text(f"{HOME}/bin/vcu-gateway").partition("\n")[0]
    assert first == f"#!/{HOME}/bin/python3 -I"


def test_the_libraries_are_the_locked_ones_and_no_other(deb, tree):
    lock = (tree / "requirements.lock").read_text()
    locked = set(re.findall(r"^([\w.-]+)==([\w.]+)", lock, flags=re.MULTILINE))
    names = [PurePosixPath(name).parent.name for name in deb.contents if name.endswith("/METADATA")]
    found = {tuple(name.removesuffix(".dist-info").rsplit("-", 1)) for name in names}
    dashed = {(name.replace("_", "-").lower(), version) for name, version in found}
    assert dashed == locked | {("vcu-gateway", __version__)}


def test_every_library_is_as_it_was_published(deb):
    changed = [
        path
        for name in deb.contents
        if name.endswith("/RECORD")
        for path, said, _ in csv.reader(io.StringIO(deb.text(name)))
        if said and said != digest(deb.contents[f"{deb.site}/{path}"])
    ]
    assert changed == []


def digest(content: bytes) -> str:
    hashed = base64.urlsafe_b64encode(hashlib.sha256(content).digest())
    return "sha256=" + hashed.decode().rstrip("=")


def test_every_file_of_the_libraries_is_on_their_lists(deb):
    listed = {
        f"{deb.site}/{path}"
        for name in deb.contents
        if name.endswith("/RECORD")
        for path, *_ in csv.reader(io.StringIO(deb.text(name)))
    }
    there = {
        name for name in deb.contents if name.startswith(deb.site) and not name.endswith(".pyc")
    }
    assert there == listed


def test_every_module_is_compiled_for_this_python_and_never_again(deb):
    sources = {name for name in deb.contents if name.startswith(deb.site) and name.endswith(".py")}
    compiled = {name for name in deb.contents if name.endswith(".pyc")}
    assert compiled == {cached(name, deb.release.python) for name in sources}
    assert len({deb.contents[name][:4] for name in compiled}) == 1  # of one Python
    assert {flags(deb.contents[name]) for name in compiled} == {0b01}  # a hash, never checked


def cached(source: str, python: str) -> str:
    path = PurePosixPath(source)
    name = f"{path.stem}.cpython-{python.replace('.', '')}.pyc"
    return str(path.parent / "__pycache__" / name)


def flags(compiled: bytes) -> int:
    return int.from_bytes(compiled[4:8], "little")


def test_a_traceback_names_the_files_where_they_are_installed(deb):
    source = f"{deb.site}/vcu_gateway/daemon/loop.py"
    named = re.findall(rb"[ -~]*loop\.py", deb.contents[cached(source, deb.release.python)])
    assert {name[name.find(b"/") :].decode() for name in named} == {f"/{source}"}


def test_nothing_in_it_tells_where_it_was_built(deb, tree):
    places = {tempfile.gettempdir().encode() + b"/tmp.", str(tree).encode()}
    telling = [
        name for name, content in deb.contents.items() if any(place in content for place in places)
    ]
    assert telling == []


def test_no_installer_and_no_test_suite_is_shipped(deb):
    folders = {name.split("/")[-1] for name, member in deb.members.items() if member.isdir()}
    assert folders.isdisjoint({"pip", "setuptools", "wheel", "test", "tests"})


def test_the_licence_of_every_library_is_named(deb):
    text = deb.text("usr/share/doc/vcu-gateway/copyright")
    folders = {name.split("/")[-2] for name in deb.contents if name.endswith(".dist-info/METADATA")}
    ours = {folder for folder in folders if folder.startswith("vcu_gateway-")}
    assert {folder for folder in folders if f"{deb.site}/{folder}/*" not in text} == ours
    used = set(re.findall(r"^License: (.+)$", text, flags=re.MULTILINE))
    explained = set(re.findall(r"^License: (.+)\n ", text, flags=re.MULTILINE))
    assert {name for line in used for name in re.split(" or | and ", line)} <= explained


def test_every_program_and_file_that_the_units_name_is_there(deb):
    missing = {
        path
        for unit in UNITS
        for line in deb.text(f"{deb.release.units}/{unit}").splitlines()
        if line.startswith(("Exec", "RootDirectory="))
        for path in re.findall(r"/(?:usr|etc)/[^\s%]+(?=\s|$)", line)
        if path.lstrip("/") not in deb.members and path != "/usr/bin/python3"
    }
    assert missing == set()


def test_it_is_small(deb):
    assert deb.path.stat().st_size < 16_000_000
    assert int(deb.field("Installed-Size")) < 64_000  # KiB
