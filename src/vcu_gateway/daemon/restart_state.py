"""State kept for the next start: a latched CUT, the directions, a drive mode; starts are counted.

A gateway that is killed, crashes or ends must not come back as if the power had never been cut, nor
with another direction than the wheels turn in.
"""

import contextlib
import json
import os
import stat
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from vcu_gateway import files
from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.core.calls import BeginFrom, BeginInMode, NoteRestartState
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.rules import EMERGENCY_STOP
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.daemon.events import EventLog
from vcu_gateway.units import NS_PER_MS, NS_PER_S

HIDDEN = "-"
"""Stands for a boot identifier that cannot be read."""

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_RUNNING, _ENDED = "running", "ended"


def boot_id() -> str:
    """Boot identifier of the kernel; `HIDDEN` where it cannot be read: /run ends with the boot."""
    with contextlib.suppress(OSError):
        return _BOOT_ID.read_text(encoding="ascii").strip() or HIDDEN
    return HIDDEN


class CountedStart(NamedTuple):
    """One start of the gateway.

    Attributes:
        number: since the machine booted, from 1.
        unexpected: starts of this drive that no end came before: killed, hung or crashed.
            A drive begins with the first start after an orderly end.
    """

    number: int
    unexpected: int


class RestartCounter:
    """Counter of one gateway's starts, in a file of its runtime folder."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "starts"
        self._now: CountedStart | None = None

    def begin(self) -> CountedStart | None:
        """Count this start; None where nothing can be kept and nothing is known of any before."""
        before, ended = self._known()
        now = CountedStart(before.number + 1, 0 if ended else before.unexpected + 1)
        self._now = now if self._write(now, _RUNNING) else None
        return now if self._now or before.number else None

    def end(self) -> None:
        if self._now is not None:
            self._write(self._now, _ENDED)

    def _known(self) -> tuple[CountedStart, bool]:
        with contextlib.suppress(OSError, ValueError):
            boot, number, unexpected, state = self._path.read_text(encoding="ascii").split()
            if boot == boot_id():
                return CountedStart(int(number), int(unexpected)), state == _ENDED
        return CountedStart(0, 0), True

    def _write(self, start: CountedStart, state: str) -> bool:
        text = f"{boot_id()} {start.number} {start.unexpected} {state}\n"
        with contextlib.suppress(OSError):
            files.replace(self._path, text)
            return True
        return False


_BEFORE = "before this start: "
_NAMESPACE = Path("/proc/self/ns/net")
_RUN = Path("/run/vcu-gateway")
_TEMPORARY = Path("/tmp")  # noqa: S108 - the folder in it is looked at before it is used
# Longer than this no stop waits: its frames go first.
_QUICK_NS = 2 * NS_PER_MS
# A thread that waited for its processor once makes no slow disk.
_MEASURED_WRITES = 3
_TRY_EVERY_NS = NS_PER_S
_NO_FOLDER = "no folder for it can be written by this user alone"


class KeptState(NamedTuple):
    """State that one process leaves to the next.

    Attributes:
        cut: why a CUT is latched; None where none is.
        reverse: the applied direction of each controller that was sent one.
    """

    cut: str | None
    reverse: Mapping[str, bool]


NOTHING = KeptState(None, {})


class RestartState:
    """The file of one bus: the boot's number, then the state as one line of JSON.

    Written by the ticking thread when it changes, and each second outside ACTIVE: the gateway is
    told whether that works, and is not armed where it does not. A CUT is written before its first
    frame, an emergency stop when it is granted, where by the last writes that delays no frame. The
    file stays after an orderly end. `others` are folders in which another run of the gateway may
    have left a latched CUT for the same bus.

    Attributes:
        path: None where nothing is kept.
    """

    def __init__(
        self,
        folder: Path | None,
        settings: BusSettings,
        gateway: Gateway,
        event_log: EventLog,
        others: Sequence[Path] = (),
    ) -> None:
        self._settings = settings
        name = file_name(settings.channel)
        self.path = None if folder is None else folder / name
        self._elsewhere = [other / name for other in others]
        self._gateway = gateway
        self._event_log = event_log
        self._written = self._now = self._tried = NOTHING
        self._tried_ns = 0
        self._took_ns: deque[int] = deque(maxlen=_MEASURED_WRITES)
        self._failure: str | None = None
        self._told: str | None = None

    def begin(self) -> None:
        """Hand the gateway what the last process of this boot left; before the first tick."""
        own: list[tuple[Path, str | None]] = []
        if self.path is not None:
            self._written = self._now = read(self.path)
            own = [(self.path, self._now.cut)]
        found = own + [(path, read(path).cut) for path in self._elsewhere]
        cuts = [(path, cut) for path, cut in found if cut is not None]
        cut_before = f"{_BEFORE}{cuts[0][1]}" if cuts else None
        self._gateway.apply(BeginFrom(cut_before, self._now.reverse))
        self._elsewhere = [path for path, _ in cuts if path != self.path]
        for path, cut in cuts:
            fields = {"file": str(path), "reason": cut}
            self._event_log.emit(Event("cut_kept", Severity.CRITICAL, fields))
        if self.path is not None:
            self._write(self.path, self._now)
        elif self._settings.interface != "virtual":
            self._fail(file_name(self._settings.channel), _NO_FOLDER)
        self._tell()

    def keep_emergency_stop(self, left_ns: int) -> None:
        """Keep a CUT that was granted, and is not answered yet; its tick is due in `left_ns`."""
        if self._written.cut is None:
            self._keep_cut(str(EMERGENCY_STOP), max(left_ns, _QUICK_NS))

    def before_sending(self) -> None:
        """After a tick's decisions: keep a CUT that it latched."""
        latched = self._latched()
        if latched is not None and latched != self._written.cut:
            self._keep_cut(latched, _QUICK_NS)

    def _keep_cut(self, cut: str, most_ns: int) -> None:
        """Write a CUT where the last write worked, and the quickest of the last ones took less."""
        if self.path is not None and self._failure is None and min(self._took_ns) < most_ns:
            self._write(self.path, self._now._replace(cut=cut))

    def observe(self, result: TickResult) -> None:
        latched = self._latched()
        if latched is None:  # after a service reset; a file that cannot be deleted latches again
            for path in self._elsewhere:
                with contextlib.suppress(OSError):
                    path.unlink()
            self._elsewhere = []
        if self.path is None:
            return
        reverse = self._now.reverse
        if result.frames:
            reverse = {name: one.motor_reverse for name, one in result.commands.items()}
        self._now = KeptState(latched, reverse)
        now_ns = result.snapshot.now_ns
        if self._is_due(result.mode, now_ns):
            self._tried_ns = now_ns
            self._write(self.path, self._now)
        self._tell()

    def _is_due(self, mode: Mode, now_ns: int) -> bool:
        """Whether to write: in ACTIVE what is new, once; else also to see whether it works."""
        if mode is Mode.ACTIVE:
            return self._now != self._tried
        return self._now != self._written or now_ns - self._tried_ns >= _TRY_EVERY_NS

    def _tell(self) -> None:
        if self._failure != self._told:
            self._told = self._failure
            self._gateway.apply(NoteRestartState(self._failure))

    def _latched(self) -> str | None:
        latch = self._gateway.supervisor.latch
        if latch is None or latch.fault_class is not FaultClass.SERVICE:
            return None
        return latch.reason.removeprefix(_BEFORE)

    def _write(self, path: Path, state: KeptState) -> None:
        self._tried = state
        text = json.dumps({"cut": state.cut, "reverse": dict(state.reverse)})
        began_ns = time.monotonic_ns()
        try:
            files.replace(path, f"{boot_id()}\n{text}\n")
        except OSError as error:
            self._fail(str(path), error.strerror or str(error))
            return
        self._took_ns.append(time.monotonic_ns() - began_ns)
        self._written, self._failure = state, None

    def _fail(self, file: str, reason: str) -> None:
        """Remember the failure; one event, however often it fails."""
        if self._failure is None:
            fields = {"file": file, "reason": reason}
            self._event_log.emit(Event("restart_state_unwritten", Severity.WARNING, fields))
        self._failure = reason


def file_name(channel: str) -> str:
    """File name of one bus: interfaces of the same name in two network namespaces are two."""
    try:
        namespace = str(_NAMESPACE.stat().st_ino)
    except OSError:
        namespace = HIDDEN
    return f"restart-{quote(channel, safe='')}-{namespace}"


def read(path: Path) -> KeptState:
    """State that the last process of this boot left; `NOTHING` where there is no file of this boot.

    A file that cannot be understood counts as a latched CUT: it may have held one.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return NOTHING
    except (OSError, ValueError) as error:
        return KeptState(f"{path} cannot be read: {error}", {})
    if lines and _is_of_another_boot(lines[0]):
        return NOTHING
    try:
        return _understood(json.loads(lines[1]))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return KeptState(f"{path} is not understood", {})


def _is_of_another_boot(identifier: str) -> bool:
    """True where both identifiers are known and differ."""
    mine = boot_id()
    known = HIDDEN not in (identifier, mine) and len(identifier) == len(mine)
    return known and identifier != mine


def _understood(document: Any) -> KeptState:
    cut, reverse = document["cut"], document["reverse"]
    if not (cut is None or isinstance(cut, str)):
        raise TypeError("the reason is a text")
    if not all(isinstance(one, bool) and name in CONTROLLERS for name, one in reverse.items()):
        raise ValueError("a direction for each controller")
    return KeptState(cut, reverse)


def folder_for(settings: BusSettings, runtime: Path | None) -> Path | None:
    """Folder for the state of this bus; None where none is kept.

    `runtime` is the service's own folder. A virtual bus ends with its process, and so does all
    that it could move.
    """
    if settings.interface == "virtual":
        return None
    if runtime is not None:
        return runtime
    own = os.environ.get("XDG_RUNTIME_DIR")
    candidates = [_RUN, *([Path(own) / "vcu-gateway"] if own else [])]
    for folder in candidates:
        if _can_be_written(folder, 0o755):
            return folder
    folder = _TEMPORARY / f"vcu-gateway-{os.geteuid()}"
    return folder if _can_be_written(folder, 0o700) and _is_mine_alone(folder) else None


def other_folders(settings: BusSettings, own: Path | None) -> list[Path]:
    """Other folders in which a run as the service or as this user may have left a state."""
    if settings.interface == "virtual":
        return []
    user = os.environ.get("XDG_RUNTIME_DIR")
    temporary = _TEMPORARY / f"vcu-gateway-{os.geteuid()}"
    candidates = [_RUN, _RUN.with_name(f"{_RUN.name}-{settings.channel}")]
    candidates += [Path(user) / "vcu-gateway"] if user else []
    candidates += [temporary] if temporary.is_dir() and _is_mine_alone(temporary) else []
    return [folder for folder in candidates if folder != own and os.access(folder, os.X_OK)]


def _can_be_written(folder: Path, mode: int) -> bool:
    with contextlib.suppress(OSError):
        folder.mkdir(mode)
    return os.access(folder, os.W_OK | os.X_OK)


def _is_mine_alone(folder: Path) -> bool:
    """Whether a folder in /tmp is no link, belongs to this user, and is closed to others."""
    found = folder.lstat()
    return (
        stat.S_ISDIR(found.st_mode)
        and found.st_uid == os.geteuid()
        and not stat.S_IMODE(found.st_mode) & 0o077
    )


_LONGEST_NAME_BYTES = 64


class KeptDriveMode:
    """The file of one bus with the name of a drive mode that only the service level leaves, if any.

    Whoever restarts the gateway, or the machine, must not leave such a mode by it. One that cannot
    be kept is in use all the same: one event tells why.
    """

    def __init__(self, folder: Path, channel: str, gateway: Gateway, event_log: EventLog) -> None:
        self._path = folder / f"drive-mode-{quote(channel, safe='')}"
        self._gateway = gateway
        self._event_log = event_log
        self._written: str | None = None

    @classmethod
    def of(
        cls, channel: str, gateway: Gateway, event_log: EventLog, runtime: Path | None
    ) -> "KeptDriveMode | None":
        """In the service's StateDirectory, else beside the restart state; None without either."""
        state = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
        folder = Path(state) if state else runtime
        return None if folder is None else cls(folder, channel, gateway, event_log)

    def begin(self) -> None:
        """Have the gateway begin in the kept mode; before the first tick."""
        try:
            name = self._path.read_bytes()[:_LONGEST_NAME_BYTES].decode("utf-8", "replace").strip()
        except FileNotFoundError:
            return
        except OSError as error:
            self._warn("drive_mode_unread", error)
            return
        self._written = name
        self._gateway.apply(BeginInMode(name))

    def observe(self, result: TickResult) -> None:
        del result
        name = self._to_keep()
        if name == self._written:
            return
        self._written = name
        try:
            if name is None:
                self._path.unlink(missing_ok=True)
            else:
                files.replace(self._path, f"{name}\n")
        except OSError as error:
            self._warn("drive_mode_unwritten", error)

    def _to_keep(self) -> str | None:
        """The mode in use, or the one that waits, where only the service level leaves it."""
        modes = self._gateway.settings.tuning.modes
        for name in self._gateway.drive_modes:
            if name is not None and name in modes and modes[name].left_by_service:
                return name
        return None

    def _warn(self, event: str, error: OSError) -> None:
        fields = {"file": str(self._path), "reason": error.strerror or str(error)}
        self._event_log.emit(Event(event, Severity.WARNING, fields))
