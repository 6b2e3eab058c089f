"""Incidents: hard links of the segments around a reason, so that the ring leaves them alone.

An incident's folder is made at once, with the segments before it and the one being written; those
that begin within the time after it are linked as they begin. So a crash at any moment loses none.
"""

import contextlib
import os
import shutil
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.files import sync
from vcu_gateway.recorder import RecorderOptions
from vcu_gateway.recorder.drive import DriveRecorder
from vcu_gateway.recorder.ring import Ring
from vcu_gateway.recorder.signing import Signer
from vcu_gateway.recorder.triggers import RESTARTED_UNEXPECTEDLY, Trigger
from vcu_gateway.recording import layout
from vcu_gateway.text import ISO_TIME, utc

_LONGEST_S = 600.0
_MOST_REASONS = 100


class OpenIncident(NamedTuple):
    """An incident whose time after it is not over.

    Attributes:
        drive: folder of its drive.
        reasons: descriptions written so far.
        begun_s, until_s: on the monotonic clock.
    """

    folder: Path
    drive: Path
    reasons: int
    begun_s: float
    until_s: float


class Incidents:
    """Incidents of all drives; belongs to the writer's thread.

    Attributes:
        size: bytes of all of them, each file once; those that somebody keeps are not counted.
        count: how many there are.
        removed: how many this process removed for want of room.
    """

    def __init__(self, options: RecorderOptions, ring: Ring, signer: Signer | None = None) -> None:
        self._options = options
        self._parent = options.folder / layout.INCIDENTS
        self._ring = ring
        self._signer = signer
        self._open: list[OpenIncident] = []
        self.size = self.count = self.removed = 0
        self._measure()

    def begin(self, trigger: Trigger, drive: DriveRecorder) -> None:
        """Keep what surrounds this moment, or lengthen the incident that is open."""
        now_s = time.monotonic()
        self._open = [one for one in self._open if one.until_s > now_s]
        opened = next((one for one in self._open if one.drive == drive.folder), None)
        if opened is not None and now_s - opened.begun_s < _LONGEST_S:
            self._lengthen(opened, trigger, drive, now_s)
            return
        if trigger.reason == RESTARTED_UNEXPECTEDLY:
            self._keep_drive_before(trigger, drive)
        files = self._ring.before(drive.folder, time.time() - self._options.before_s)
        folder = self._create(trigger, drive.folder, [*files, *open_files(drive)])
        until_s = now_s + self._options.after_s
        self._open.append(OpenIncident(folder, drive.folder, 1, now_s, until_s))

    def segment_began(self, drive: DriveRecorder) -> None:
        now_s = time.monotonic()
        for one in self._open:
            if one.drive == drive.folder and one.until_s > now_s:
                layout.link_files(open_files(drive), one.folder)
                sync(one.folder)

    def forget_ended(self) -> None:
        """Forget incidents that are over, and keep within the budget."""
        now_s = time.monotonic()
        over = [one for one in self._open if one.until_s <= now_s]
        if over:
            self._open = [one for one in self._open if one.until_s > now_s]
            self.keep_budget()

    def _lengthen(
        self, opened: OpenIncident, trigger: Trigger, drive: DriveRecorder, now_s: float
    ) -> None:
        layout.link_files(open_files(drive), opened.folder)
        sync(opened.folder)
        reasons = opened.reasons
        if reasons < _MOST_REASONS:
            reasons += 1
            path = opened.folder / f"incident-{reasons}.json"
            links = [one for found in layout.segments(opened.folder) for one in found.paths]
            description = self._description(trigger, opened.folder, opened.drive.name, links)
            layout.write_new(path, description)
            sync(opened.folder)
        longer = opened._replace(reasons=reasons, until_s=now_s + self._options.after_s)
        self._open[self._open.index(opened)] = longer

    def _keep_drive_before(self, trigger: Trigger, drive: DriveRecorder) -> None:
        """Keep the end of the drive whose gateway did not end in order."""
        before = self._ring.last_drive(drive.hello["channel"], drive.folder)
        if before is not None:
            files = self._ring.before(before, time.time() - self._options.before_s)
            self._create(trigger, before, files, "-before")

    def _create(
        self, trigger: Trigger, drive: Path, files: Iterable[Path], suffix: str = ""
    ) -> Path:
        name = layout.incident_name(time.time_ns(), trigger.kind) + suffix
        folder, links = layout.free_path(self._parent / name), list(files)
        description = self._description(trigger, drive, drive.name, links)
        copies = _copies(drive)
        layout.create_folder(folder, {layout.INCIDENT_FILE: description, **copies}, links)
        if self._signer is not None:
            self._signer.incident_made(folder, drive)
        self.keep_budget(newest=folder)
        return folder

    def _description(
        self, trigger: Trigger, described_in: Path, drive: str, links: Iterable[Path]
    ) -> bytes:
        wall_ns, options = time.time_ns(), self._options
        when = {"at": utc(wall_ns, ISO_TIME), "at_ns": wall_ns}
        kept = {"before_s": options.before_s, "after_s": options.after_s, "drive": drive}
        described = layout.description_if_any(described_in / layout.DRIVE_FILE)
        incident = trigger._asdict() | when | kept
        return layout.incident_bytes(incident, described, links, _copies(described_in))

    def keep_budget(self, newest: Path | None = None) -> None:
        """Remove incidents above the budget: of a kind that has several, not its first."""
        folders, staying = self._measure(), {newest, *(one.folder for one in self._open)}
        while self.size > self._options.incident_max_bytes:
            removable = [one for one in folders if one not in staying]
            chosen = _least_wanted(removable, folders)
            if chosen is None:
                return
            shutil.rmtree(chosen, ignore_errors=True)
            self.removed += 1
            folders = self._measure()

    def _measure(self) -> list[Path]:
        """Incidents that nobody keeps, oldest first; counts them and their bytes."""
        folders = layout.recorded_folders(self._parent)
        self.count = len(folders)
        counted = [one for one in folders if not os.path.lexists(one / layout.KEEP_FILE)]
        sizes: dict[int, int] = {}
        for folder in counted:
            with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:
                sizes |= {entry.inode(): entry.stat().st_size for entry in entries}
        self.size = sum(sizes.values())
        return counted


def open_files(drive: DriveRecorder) -> list[Path]:
    if drive.segment is None:
        return []
    number = drive.segment.number
    return [drive.folder / name(number) for name in (layout.frames_name, layout.core_name)]


def _copies(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in layout.FILES_BESIDE}


def _least_wanted(removable: list[Path], folders: list[Path]) -> Path | None:
    """The second oldest of the kind that there is most of; else the oldest of all."""
    kinds = {folder: _kind(folder) for folder in folders}
    counts = Counter(kinds.values())
    firsts = {kind: folder for folder, kind in reversed(kinds.items())}
    further = [folder for folder in removable if firsts[kinds[folder]] != folder]
    most = max((counts[kinds[folder]] for folder in further), default=0)
    chosen = [folder for folder in further if counts[kinds[folder]] == most] or removable
    return chosen[0] if chosen else None


def _kind(folder: Path) -> str:
    return str(layout.description_if_any(folder / layout.INCIDENT_FILE).get("kind"))
