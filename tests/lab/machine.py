"""A guest with a systemd of its own: its root, and what it sees of this machine."""

import configparser
import contextlib
import os
import platform
import shutil
import subprocess
from pathlib import Path

import guest
from guest import CannotError

PACKAGES = {
    "mmdebstrap": "mmdebstrap",
    "tar2sqfs": "squashfs-tools-ng",
    "/usr/share/keyrings/debian-archive-keyring.gpg": "debian-archive-keyring",
}
MODULES = ("overlay", "squashfs")
KERNEL_OPTIONS = "selinux=0 systemd.show_status=auto"
SUITES = ("bookworm", "trixie")
SQUASHFS = b"hsqs"  # its first bytes
REPOSITORY = Path(__file__).parents[2]
# Of the guest's own; a folder of the machine must not hide one.
SYSTEM = (
    *("/", "/bin", "/etc", "/lib", "/lib64", "/mnt", "/sbin", "/tmp", "/usr", "/var", "/var/tmp"),
)


def own_suite():
    """This machine's own, where its interpreters work, if there is a root of it; else the first."""
    with contextlib.suppress(OSError):
        suite = platform.freedesktop_os_release().get("VERSION_CODENAME")
        return suite if suite in SUITES else SUITES[0]
    return SUITES[0]


def missing_packages():
    return missing(PACKAGES if os.geteuid() == 0 else PACKAGES | {"newuidmap": "uidmap"})


def missing(packages):
    """The packages, {tool or file: package}, whose tools are not there."""
    there = (bool(shutil.which(tool)) or Path(tool).exists() for tool in packages)
    return sorted(name for name, found in zip(packages.values(), there, strict=True) if not found)


def prepare(job, root, also, packages):
    """Puts what init-systemd.sh needs into the job directory.

    root is a directory, a squashfs image or the name of a Debian suite.
    """
    folders = shared_folders(also)
    for folder in folders:
        guest.require_visible(folder)
    (job / "root").symlink_to(find_root(root))
    write_lines(job / "shared", folders)
    write_lines(job / "packages", [copied(job, Path(package)) for package in packages])


def write_lines(path, lines):
    path.write_text("".join(f"{line}\n" for line in lines))


def copied(job, package):
    try:
        return shutil.copy(package, job / package.name).name
    except OSError as error:
        raise CannotError(f"--install {package}: {error.strerror}") from None


def find_root(given):
    """The directory or image to boot; that of a Debian suite is built where it is not yet."""
    root = Path(built(given) if given in SUITES else given).absolute()
    if root.is_dir():
        return root
    try:
        with root.open("rb") as image:
            if image.read(len(SQUASHFS)) == SQUASHFS:
                return root
    except OSError as error:
        raise CannotError(f"--root {root}: {error.strerror}") from None
    raise CannotError(f"--root {root}: neither a directory nor a squashfs image")


def built(suite):
    script = Path(__file__).with_name("debian-root")
    done = subprocess.run([script, suite], stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise CannotError("no root for the guest")
    return done.stdout.strip()


def kernel_options(job):
    """What the kernel's command line needs besides."""
    disk = [f"ubd0r={job}/root"] if (job / "root").is_file() else []
    # This kernel has RT_GROUP_SCHED: beside the cpu controller no service may be real-time.
    return [*KERNEL_OPTIONS.split(), "cgroup_disable=cpu", *disk]


def shared_folders(also):
    """What the guest sees: this directory, the interpreter of its .venv, and those named."""
    folders = {os.getcwd(), *interpreter_folders(), *(os.path.abspath(folder) for folder in also)}
    for folder in folders:
        if not os.path.isdir(folder):
            raise CannotError(f"{folder}: no such directory")
        if folder in SYSTEM:
            raise CannotError(f"{folder} cannot be shown to a guest that has its own")
    return sorted(folders)  # the outer before the inner


def interpreter_folders():
    """Where .venv has its interpreter from, by the name it uses and by its real one."""
    for venv in (Path(".venv"), REPOSITORY / ".venv"):
        if (settings := venv / "pyvenv.cfg").is_file():
            parser = configparser.ConfigParser(interpolation=None)
            parser.read_string(f"[venv]\n{settings.read_text()}")
            named = Path(parser["venv"]["home"]).parent
            real = (venv / "bin" / "python").resolve().parents[1]
            return {str(path) for path in (named, real) if str(path) not in SYSTEM}
    return set()
