"""What a User Mode Linux guest needs: packages, modules, memory, kernel command line, settings."""

import contextlib
import fcntl
import functools
import os
import random
import re
import shutil
import subprocess
from pathlib import Path

DISK = "/dev/ubdb"  # the first one is the root's, with a systemd
TMPDIR = "/run/tmp"  # in the guest: in RAM. /tmp stays the machine's, a command may live there
# Whom init.sh passes signals on to, and what it kills at the end.
PREPARE = "echo $$ >/run/lab/group\necho $$ >/run/lab/cgroup/command/cgroup.procs\n"

PACKAGES = {
    "linux.uml": "user-mode-linux",
    "busybox": "busybox-static",
    "ip": "iproute2",
    "tc": "iproute2",
}
MODULES = ("can", "can-raw", "can-bcm", "can-j1939", "can-dev", "vcan")
MODULE_TREE = Path("/usr/lib/uml/modules")
OVERLAID = ("/dev", "/proc", "/run", "/sys")  # the guest mounts its own here


class CannotError(Exception):
    """The guest cannot be had; the message says why and what to do."""


def missing_packages():
    missing = {package for tool, package in PACKAGES.items() if not shutil.which(tool)}
    if not any(MODULE_TREE.glob("*/kernel/net/can/can.ko*")):
        missing.add("user-mode-linux")
    return sorted(missing)


def require(directory):
    """Raises unless a guest can start and sees the directory."""
    if missing := missing_packages():
        raise CannotError(
            f"no CAN in this kernel and no {', '.join(missing)} installed: run `lab install`"
        )
    require_visible(directory)


def require_visible(directory):
    """Raises unless a guest can see the directory."""
    if f"{directory}/".startswith(tuple(f"{top}/" for top in OVERLAID)):
        raise CannotError(
            f"{directory} is invisible in the guest, which has its own {', '.join(OVERLAID)}"
        )


@functools.cache
def release():
    return subprocess.run(["linux.uml", "--version"], capture_output=True, text=True).stdout.strip()


def kernel_command(job, mem):
    """The guest's command line; leaves out benchmarks and old ptys: boots in 0.2 s, not 1.2 s."""
    return [
        *f"linux.uml rootfstype=hostfs rootflags=/ rw quiet con=null mem={mem}".split(),
        *f"init={job}/init uml_dir={job} umid=uml pty.legacy_count=0".split(),
        "initcall_blacklist=raid6_select_algo,calibrate_xor_blocks",
    ]


def consoles(control, keys, out, err):
    """Options that connect console 0, 1 and 2 with these file descriptors, the log with stdout."""
    return [f"con0=fd:{control},fd:1", f"con1=fd:{keys},fd:{out}", f"con2=null,fd:{err}"]


def take_processor():
    """Ties this process, and so the guest, to one processor, no other lab's if one is free.

    The guest's processes take turns by ptrace: on one processor a turn costs a third of what it
    costs between two. The open file keeps other labs off it until this process ends.
    """
    processors = sorted(os.sched_getaffinity(0))
    for number in processors:
        file = os.open(f"/tmp/vcu-lab.{os.getuid()}.processor{number}", os.O_CREAT | os.O_RDWR)
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        os.close(file)
    else:
        number = random.choice(processors)
    os.sched_setaffinity(0, {number})


def settings(interactive, kind="uml"):
    """How init.sh is to connect the command's output, as shell variables; kind is the guest's."""
    kinds = ["tty" if os.isatty(fd) else "pipe" for fd in (1, 2)]
    if os.path.sameopenfile(1, 2):
        kinds[1] = "merged"  # one channel keeps the order of lines
    columns, rows = shutil.get_terminal_size()
    size = f"rows={rows} cols={columns}"
    how = f"kind={kind} stdout={kinds[0]} stderr={kinds[1]}"
    return f"{how} {size} interactive={'yes' * interactive}\n"


def memory_directory(mem):
    """Where the guest's memory file goes: in RAM where it fits, never on a noexec mount."""
    if not (size := re.fullmatch(r"(\d+)([MG])", mem)):
        raise CannotError(f"--mem {mem}: must be a number and M or G")
    needed = int(size[1]) << {"M": 20, "G": 30}[size[2]]
    for directory in ("/dev/shm", "/tmp", "/var/tmp"):
        with contextlib.suppress(OSError):
            place = os.statvfs(directory)
            if not place.f_flag & os.ST_NOEXEC and place.f_bavail * place.f_frsize > needed:
                return directory
    raise CannotError(f"no room for {mem} in /dev/shm, /tmp or /var/tmp: use a smaller --mem")


def module_lines(extra, params, tree=None):
    """Lines "path parameters" for the standard and extra modules, each after those it needs.

    params are pairs such as ("vcan", "echo=1"); tree has the modules of one kernel, that of User
    Mode Linux if not given.
    """
    tree = tree or MODULE_TREE / release()
    paths = {plain(path.name.split(".ko")[0]): path for path in tree.rglob("*.ko*")}
    needs = dependencies(tree)
    options = {}
    for module, option in params:
        options.setdefault(plain(module), []).append(option)
    lines = {}
    for name in dict.fromkeys(plain(name) for name in [*MODULES, *extra, *options]):
        if name not in paths:
            raise CannotError(f"the guest's kernel {tree.name} has no module {name}")
        for path in (*needs.get(paths[name], ()), paths[name]):
            lines[path] = " ".join([str(path), *options.get(plain(path.name.split(".ko")[0]), ())])
    return "".join(f"{line}\n" for line in lines.values())


def plain(name):
    return name.replace("_", "-")


def dependencies(tree):
    """{module path: the paths it needs, in loading order}; empty without a modules.dep."""
    with contextlib.suppress(FileNotFoundError):
        lines = (
            line.replace(":", "").split()
            for line in (tree / "modules.dep").read_text().splitlines()
        )
        return {
            tree / module: [tree / need for need in reversed(needs)] for module, *needs in lines
        }
    return {}
