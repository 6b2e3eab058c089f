"""The systems, their Pythons, and how a terminal on each is come by."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.systems.promises import REPOSITORY
from tests.systems.terminal import PROFILE

FOLDER = REPOSITORY / "build" / "systems"
HERE = Path(__file__).parent
CLEAN_ROOT = REPOSITORY / "scripts" / "clean-root"
# An ordinary user who may use sudo; no Python is there. $1 is the root's folder.
NEWCOMER = (
    """--customize-hook=chroot "$1" useradd --create-home --shell /bin/bash user""",
    """--customize-hook=echo "user ALL=(ALL) NOPASSWD: ALL" >"$1/etc/sudoers.d/user\"""",
)
BUNDLE = "vcu-gateway.bundle"

_NAMESPACES = "unshare --mount --pid --uts --ipc --fork --kill-child"
_CA = "/etc/ssl/certs/machine.pem"
_CA_VARIABLES = ("PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE")
_PROXY = re.compile(r"(https?|all|no)_proxy", re.IGNORECASE)


class System(NamedTuple):
    """A distribution's suite, the Python that it has, and a package of the lab that it has not."""

    suite: str
    name: str
    python: str
    lacks: str = ""


SYSTEMS = {
    one.suite: one
    for one in (
        System("bookworm", "Debian 12", "3.11"),
        System("noble", "Ubuntu 24.04", "3.12", lacks="user-mode-linux"),
        System("trixie", "Debian 13", "3.13"),
        System("forky", "Debian testing", "3.14"),
    )
}


class CannotError(Exception):
    """What cannot be had on this machine, in a sentence."""


def clean_root(system: System, folder: Path) -> str:
    """Lay a clean root of the system into the folder; the command of its terminal."""
    command: list[str | Path] = [CLEAN_ROOT, "newcomer", system.suite, "sudo,apt,tzdata", *NEWCOMER]
    built = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if built.returncode:
        raise CannotError(f"no root of {system.name} can be had")
    remove(folder)
    folder.mkdir()
    subprocess.run(["tar", "-xf", built.stdout.strip(), "-C", folder], check=True)
    _connect(folder, system.suite)
    lay_home(folder / "home" / "user", _CA)
    subprocess.run(["chroot", folder, "chown", "-R", "user:", "/home/user"], check=True)
    return f"{_NAMESPACES} {shlex.join([str(HERE / 'enter-root'), str(folder), system.suite])}"


def installed_python(version: str) -> str | None:
    """The path of an interpreter of this version on this machine: in the PATH, by pyenv, by uv."""
    name = f"python{version}"
    found = [Path(path)] if (path := shutil.which(name)) else []
    found += Path.home().glob(f".pyenv/versions/{version}*/bin/{name}")
    found += Path.home().glob(f".local/share/uv/python/cpython-{version}*/bin/{name}")
    return next((str(path) for path in found if _runs(path)), None)


def lay_home(home: Path, ca_bundle: str | None = None) -> None:
    """Lay the repository to clone and a shell's profile into the home of a newcomer.

    ca_bundle is where this machine's bundle of CA certificates is there, None for where it is here.
    """
    (home / ".bash_profile").write_text(PROFILE + "".join(_exports(ca_bundle)))
    git = ["git", "-c", f"safe.directory={REPOSITORY}", "-C", str(REPOSITORY)]
    said = subprocess.run([*git, "symbolic-ref", "-q", "HEAD"], stdout=subprocess.PIPE, text=True)
    bundle = ["bundle", "create", "--quiet", str(home / BUNDLE), "HEAD", *said.stdout.split()]
    subprocess.run([*git, *bundle], check=True)


def remove(folder: Path) -> None:
    """Remove a root or a home, whoever its files belong to."""
    subprocess.run(["rm", "-rf", "--one-file-system", folder], check=True)


def _connect(root: Path, hostname: str) -> None:
    """Let the root reach the package indexes in the way that this machine does."""
    (root / "etc/resolv.conf").unlink(missing_ok=True)
    shutil.copyfile("/etc/resolv.conf", root / "etc/resolv.conf")
    (root / "etc/hosts").write_text(f"127.0.0.1 localhost\n::1 localhost\n127.0.1.1 {hostname}\n")
    if bundle := _ca_bundle():
        (root / _CA[1:]).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(bundle, root / _CA[1:])
    if settings := "".join(f"{name} = {value}\n" for name, value in _pip_settings()):
        (root / "etc/pip.conf").write_text(f"[global]\n{settings}")
    proxies = subprocess.run(["apt-config", "dump"], stdout=subprocess.PIPE, text=True).stdout
    lines = re.findall(r"^Acquire::.*Proxy.*\n", proxies, re.MULTILINE)
    (root / "etc/apt/apt.conf.d/80machine").write_text("".join(lines))


def _runs(python: Path) -> bool:
    """Whether it is an interpreter: pyenv has a script by its name for what is not chosen."""
    return subprocess.run([python, "-c", ""], stderr=subprocess.DEVNULL).returncode == 0


def _exports(ca_bundle: str | None) -> Iterator[str]:
    for name in os.environ:
        if name == "CI" or _PROXY.fullmatch(name):
            yield f"export {name}={shlex.quote(os.environ[name])}\n"
    if here := _ca_bundle():
        yield f"export {' '.join(f'{name}={ca_bundle or here}' for name in _CA_VARIABLES)}\n"


def _ca_bundle() -> str | None:
    return next((os.environ[name] for name in _CA_VARIABLES if os.environ.get(name)), None)


def _pip_settings() -> Iterator[tuple[str, str]]:
    """pip's settings on this machine but for the folders of it, which the root has not."""
    command = [sys.executable, "-m", "pip", "config", "list"]
    said = subprocess.run(command, stdout=subprocess.PIPE, text=True).stdout
    for name, value in re.findall(r"^(?:global|:env:)\.([\w-]+)=(.*)$", said, re.MULTILINE):
        words = ast.literal_eval(value).split()
        kept = [word for word in words if not word.startswith(("/", "file:"))]
        if kept:
            yield name, " ".join(kept)
