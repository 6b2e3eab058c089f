"""The processor state that this host keeps for a traced process, and a library where it is large.

User Mode Linux 6.1 knows 2,696 bytes of it. A host that keeps more, as one with AMX does
(11,008 bytes), refuses to take them back, and the guest dies at its first process. There a
preloaded ptrace(), xstate.c, sets the whole.
"""

import ctypes
import errno
import functools
import hashlib
import os
import platform
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from guest import CannotError

SOURCE = Path(__file__).with_name("xstate.c")
REPOSITORY = Path(__file__).resolve().parents[2]
FOLDER = REPOSITORY / "build" / "lab"
COMPILE = ("cc", "-O2", "-Wall", "-Wextra", "-shared", "-fPIC")
KNOWN_BYTES = 2696  # to User Mode Linux
MOST_BYTES = 1 << 16
# <sys/ptrace.h>, <elf.h>
PTRACE_TRACEME, PTRACE_GETREGSET, PTRACE_SETREGSET, NT_X86_XSTATE = 0, 0x4204, 0x4205, 0x202


class HostState(NamedTuple):
    """What the host keeps: its length in bytes, and whether it refuses the guest's shorter one."""

    length: int
    refuses: bool


class Iovec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


@functools.cache
def host_state():
    """Measured on a traced child; length 0 where the host has no such state."""
    if platform.machine() != "x86_64":
        return HostState(0, False)
    ptrace = ctypes.CDLL(None, use_errno=True).ptrace
    ptrace.argtypes, ptrace.restype = [ctypes.c_long] * 3 + [ctypes.c_void_p], ctypes.c_long
    child = os.fork()
    if child == 0:
        if ptrace(PTRACE_TRACEME, 0, 0, None) == 0:
            os.kill(os.getpid(), signal.SIGSTOP)
        os._exit(0)
    if not os.WIFSTOPPED(os.waitpid(child, os.WUNTRACED)[1]):
        raise CannotError("User Mode Linux needs ptrace, which this machine does not permit")
    try:
        state = ctypes.create_string_buffer(MOST_BYTES)
        whole = Iovec(ctypes.addressof(state), MOST_BYTES)
        if ptrace(PTRACE_GETREGSET, child, NT_X86_XSTATE, ctypes.byref(whole)) != 0:
            return HostState(0, False)
        known = Iovec(ctypes.addressof(state), KNOWN_BYTES)
        taken = ptrace(PTRACE_SETREGSET, child, NT_X86_XSTATE, ctypes.byref(known)) == 0
        return HostState(whole.length, not taken and ctypes.get_errno() == errno.EFAULT)
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def processor():
    """The processor's name, as the kernel has it."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def missing_packages():
    """The compiler's, where the library is needed and not built."""
    if not host_state().refuses or library_path().exists():
        return []
    there = {"gcc": shutil.which("cc"), "libc6-dev": os.path.exists("/usr/include/stdio.h")}
    return [package for package, found in there.items() if not found]


def library_path():
    return FOLDER / f"xstate-{hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:12]}.so"


def library():
    """The library's path; built where it is not there yet."""
    path = library_path()
    if path.exists():
        return path
    if missing := missing_packages():
        raise CannotError(
            f"this processor's state ({host_state().length:,} bytes) is larger than User Mode Linux"
            f" knows; what mends it takes {' and '.join(missing)}: run `lab install`"
        )
    try:
        FOLDER.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=FOLDER) as folder:
            new = Path(folder, path.name)
            compiler = subprocess.run(
                [*COMPILE, "-o", new, SOURCE], stderr=subprocess.PIPE, text=True
            )
            if compiler.returncode != 0:
                said = compiler.stderr.strip().splitlines() or ["it says nothing"]
                raise CannotError(f"cc cannot build {SOURCE}: {said[-1]}")
            if os.geteuid() == 0:  # in somebody else's checkout: theirs
                owner = REPOSITORY.stat()
                for made in (FOLDER.parent, FOLDER, new):
                    os.chown(made, owner.st_uid, owner.st_gid)
            new.rename(path)
    except OSError as error:
        raise CannotError(f"cannot write {path}: {error.strerror}") from None
    return path


def environment(job):
    """The variables that linux.uml itself needs; its guest does not see them."""
    if not host_state().refuses:
        return {}
    link = job / "ptrace.so"  # LD_PRELOAD takes no path with a space
    link.symlink_to(library())
    return {"LD_PRELOAD": ":".join(filter(None, (str(link), os.environ.get("LD_PRELOAD"))))}
