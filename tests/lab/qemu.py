"""A guest under QEMU: Debian's ordinary kernel on an emulated computer with two CAN controllers."""

import os
import platform
import subprocess
from pathlib import Path
from typing import NamedTuple

import guest
import machine
from guest import CannotError

SCRIPT = Path(__file__).with_name("debian-kernel")
FLAVOURS = ("standard", "rt")
UML_MACHINES = ("x86_64", "i686")  # what Debian builds User Mode Linux for
IN_GUEST = "/lib/modules"
DISK = "/dev/vdb"  # the first one is the root's


class Architecture(NamedTuple):
    """How QEMU emulates one.

    Attributes:
        debian: its name in Debian.
        package: of the emulator.
        computer: options of the emulator; `max` is every feature that it can emulate.
        console: the kernel's name of the first serial line.
    """

    debian: str
    emulator: str
    package: str
    computer: str
    console: str


# By the name that the kernel has for it.
ARCHITECTURES = {
    "x86_64": Architecture(
        "amd64", "qemu-system-x86_64", "qemu-system-x86", "-machine q35 -cpu max", "ttyS0"
    ),
    "aarch64": Architecture(
        "arm64", "qemu-system-aarch64", "qemu-system-arm", "-machine virt -cpu max", "ttyAMA0"
    ),
}
TOOLS = {"depmod": "kmod", "busybox": "busybox-static", "xz": "xz-utils", **machine.PACKAGES}
# KVM hangs on some machines that offer it, and few virtual ones do.
#
# The guest's clock counts its instructions, one a nanosecond, and leaps over what it would idle
# away: a busy machine makes the guest slow and never late, and a bound holds or does not. Such a
# clock is for one processor. While the guest waits for the machine's files the clock leaps from
# timer to timer: the periodic ticks of nohz=off keep these leaps short.
EMULATION = """-accel tcg,thread=single -icount shift=0,sleep=off -smp 1
    -nodefaults -no-user-config -display none -no-reboot"""
# mitigations: there is nothing to protect. tsc: the kernel would take a slower clock for safety.
KERNEL_OPTIONS = "quiet nohz=off tsc=reliable mitigations=off nokaslr"
CONTROLLERS = """-object can-bus,id=bus
    -device kvaser_pci,canbus=bus -device kvaser_pci,canbus=bus"""


def is_needed():
    """Whether this machine has no other way than its own kernel."""
    return os.environ.get("LAB_WAY") == "qemu" or platform.machine() not in UML_MACHINES


def architecture():
    try:
        return ARCHITECTURES[platform.machine()]
    except KeyError:
        known = ", ".join(ARCHITECTURES)
        raise CannotError(f"no lab for {platform.machine()}: only for {known}") from None


def missing_packages():
    own = architecture()
    return machine.missing({own.emulator: own.package, **TOOLS})


def prepare(job, options, modules):
    """Puts what init needs into the job directory; returns the emulator's command line."""
    if missing := missing_packages():
        raise CannotError(f"no {', '.join(missing)} installed: run `lab install --qemu`")
    kernel = find_kernel(options)
    machine.prepare(job, options.root, options.also, options.install)
    if (job / "root").is_dir():
        raise CannotError(f"--root {options.root}: QEMU boots an image, not a directory")
    (tree,) = (kernel / "modules").iterdir()
    lines = guest.module_lines(modules, options.module_param, tree)
    (job / "modules").write_text(lines.replace(f"{kernel}/modules", IN_GUEST))
    return command(job, kernel, options.mem, options.disk)


def find_kernel(options):
    """The folder of Debian's kernel of the root's suite; unpacked where it is not yet."""
    suite = options.root if options.root in machine.SUITES else machine.own_suite()
    argv = [SCRIPT, suite, options.kernel, architecture().debian]
    done = subprocess.run(argv, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise CannotError("no kernel for the guest")
    return Path(done.stdout.strip())


def command(job, kernel, mem, disk=None):
    own = architecture()
    # Nobody writes it, and guests of User Mode Linux lock it, too.
    root = f"file={escaped((job / 'root').resolve())},file.locking=off"
    disks = [f"{root},format=raw,if=virtio,readonly=on"]
    disks += [f"file={escaped(disk)},format=raw,if=virtio"] if disk else []
    options = f"console={own.console} {KERNEL_OPTIONS} {machine.KERNEL_OPTIONS}"
    folders = (job / "shared").read_text().splitlines()
    shares = [("job", job, False), ("modules", kernel / "modules", True)]
    shares += [(f"folder{number}", folder, True) for number, folder in enumerate(folders)]
    return [
        *(own.emulator, *own.computer.split(), *EMULATION.split(), "-m", mem),
        *("-kernel", kernel / "vmlinuz", "-initrd", kernel / "initramfs", "-append", options),
        *(word for one in disks for word in ("-drive", one)),
        *(word for share in shares for word in ("-virtfs", shared(*share))),
        *CONTROLLERS.split(),
    ]


def shared(tag, folder, read_only):
    """The option that shows a folder to the guest; it mounts it by the tag."""
    how = "security_model=none,multidevs=remap" + ",readonly=on" * read_only
    return f"local,path={escaped(folder)},mount_tag={tag},{how}"


def escaped(path):
    """A path within an option of QEMU's."""
    return str(path).replace(",", ",,")


def consoles(job, control, keys, out, err):
    """Options that connect /dev/hvc0, 1 and 2 with these file descriptors, the log with stdout."""
    ends = {"control": (control, None), "output": (keys, out)}
    for name, numbers in ends.items():  # QEMU's "pipe" is two files, named thus
        for number, suffix in zip(numbers, ("in", "out"), strict=True):
            target = "/dev/null" if number is None else f"/proc/self/fd/{number}"
            (job / f"{name}.{suffix}").symlink_to(target)
    return [
        *("-chardev", "stdio,id=log,signal=off", "-serial", "chardev:log"),
        *("-device", "virtio-serial"),
        *(word for name in ends for word in port(name, f"pipe,path={escaped(job / name)}")),
        *port("errors", f"file,path=/proc/self/fd/{err},append=on"),
    ]


def port(name, backend):
    return "-chardev", f"{backend},id={name}", "-device", f"virtconsole,chardev={name}"


def emulator_version():
    """As it tells it, without the distribution's."""
    told = subprocess.run([architecture().emulator, "--version"], capture_output=True, text=True)
    return told.stdout.partition(" version ")[2].partition(" ")[0] if told.stdout else "?"
