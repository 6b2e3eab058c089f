"""Writer's thread: takes what was received and puts it on the disk, however long that takes."""

import contextlib
import errno
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from vcu_gateway.recorder import RecorderOptions, triggers
from vcu_gateway.recorder.connection import GatewayConnection
from vcu_gateway.recorder.drive import DriveRecorder
from vcu_gateway.recorder.incidents import Incidents
from vcu_gateway.recorder.receiver import Backlog, Received
from vcu_gateway.recorder.ring import (
    KEPT_WITHOUT_ROOM,
    Disk,
    Ring,
    is_full,
    is_of_a_name,
    probe,
    room_bytes,
)
from vcu_gateway.recorder.senders import Refusals
from vcu_gateway.recorder.signing import Signer
from vcu_gateway.recorder.triggers import Trigger
from vcu_gateway.recording import layout
from vcu_gateway.recording.datagram import DatagramError
from vcu_gateway.recording.recorder_status import RecorderTotals

_MEMBER_S = 0.94
"""A member is due then, once all that waits was taken: a killed recorder loses a second at most."""
_SYNC_S = 5.0
_SYNC_AFTER_LATCH_S = 0.1
_AFTER_LATCH_S = 2.0
_MOST_WAITING = 1 << 20
_MOST_SEGMENT_BYTES = 16 << 20
_SIGN_WITHIN_S = 2.5
_MOST_PENDING = 100
_NO_LINKS = (errno.EXDEV, errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK)
"""What a file system answers that has no hard links, or is another one."""
_MOST_RUNS = 8
_ROOM_BYTES = 1 << 20


class Writer:
    """Writes every drive; `wake`, `write_if_due`, `request_incident` and `stop` are for others.

    Attributes:
        wake: set where something is urgent, or due.
        thread: started by whoever made this; ended before `stop` by a bug alone.
    """

    def __init__(self, options: RecorderOptions, say: Callable[[str], None]) -> None:
        """Find what is recorded already; OSError where the folder cannot be read."""
        self.backlog = Backlog(options.memory_bytes)
        self.disk = Disk(say)
        self.refusals = Refusals(say)
        self.totals = RecorderTotals()
        self.ring = Ring(options.folder / layout.DRIVES)
        key, incidents = options.sign_key, options.folder / layout.INCIDENTS
        self.signer = None if key is None else Signer(key, incidents, say)
        self.incidents = Incidents(options, self.ring, self.signer)
        self.drives: dict[GatewayConnection, DriveRecorder] = {}
        self._options = options
        self._say = say
        self._runs: dict[str, DriveRecorder] = {}
        self._held: Received | None = None
        # What is to be done for incidents; None: link the segment that a drive began.
        self._pending: deque[tuple[DriveRecorder, Trigger | None]] = deque()
        self.wake = threading.Event()
        self._stopping = self._requested = self._urgent = self._links_missing = False
        self._member_s = self._sync_s = self._latched_until_s = 0.0
        self.thread = threading.Thread(target=self._run, name="writer", daemon=True)

    def write_if_due(self) -> None:
        """Write what is due or asked for; for the receiver, when it has taken all that waits."""
        if self._requested or time.monotonic() >= self._member_s:
            self.wake.set()

    def request_incident(self) -> None:
        self._requested = True  # no more: a signal's handler must not wait for the event's lock

    def stop(self, timeout_s: float) -> bool:
        """Write what is there and end; False where the disk does not let it in that time."""
        self._stopping = True
        self.wake.set()
        self.thread.join(timeout_s)
        if self.signer is not None:
            self.signer.stop(_SIGN_WITHIN_S)
        return not self.thread.is_alive()

    def _run(self) -> None:
        while True:
            stopping = self._stopping
            self.disk.busy(True)
            self._turn(stopping)
            self.disk.busy(False)
            if stopping:
                return
            due_s = self._sync_s - time.monotonic()
            self.wake.wait(max(self.disk.pause_s, due_s, 0.01))
            self.wake.clear()

    def _turn(self, stopping: bool) -> None:
        if self.disk.pause_s and not stopping:
            return
        before = self.totals.bytes
        try:
            self._take_all()
            self._write(time.monotonic())
            if stopping:
                for drive in self.drives.values():
                    drive.close("the recorder stopped")
            if self.disk.is_in_trouble and self.totals.bytes == before:  # nothing waited
                probe(self._options.folder)
        except OSError as error:
            self._failed(error)
        else:
            self.disk.worked()

    def _failed(self, error: OSError) -> None:
        if is_full(error) and self.ring.make_room(_ROOM_BYTES):
            self._say("the disk is full; the oldest recordings make room")
            self.wake.set()
            return
        self.disk.failed(error)

    def _take_all(self) -> None:
        """Take everything that was received; what cannot be taken now stays the next one."""
        while True:
            self._held = self._held or self.backlog.take()
            if self._held is None:
                return
            try:
                self._take(self._held)
            except OSError:
                raise
            except Exception as error:  # noqa: BLE001 - the others go on
                self._give_up(self._held.connection, error)
            self._held = None
            for drive in self.drives.values():
                if drive.segment is not None and drive.segment.waiting > _MOST_WAITING:
                    self._flush(drive)

    def _give_up(self, connection: GatewayConnection, error: Exception) -> None:
        """Have a connection closed whose data cannot be written; what waits of it is lost."""
        connection.fault = connection.fault or DatagramError(repr(error)[:200], "fault")
        drive = self.drives.get(connection)
        if drive is not None:
            drive.abandon("what was handed over could not be written")

    def _take(self, item: Received) -> None:
        connection, tick = item.connection, item.tick
        if tick is None:
            self._close(connection)
            return
        if connection.fault is not None:
            return
        drive = self._drive_of(connection)
        before = drive.segment
        with self._abandoning(drive):
            taken = drive.take(tick)
        if not taken:
            connection.begin_again = True
            return
        if drive.segment is not before:
            self._keep_cap()
            self._pending.append((drive, None))
        elif before is not None and before.size > _MOST_SEGMENT_BYTES:
            connection.begin_again = True
        if item.is_urgent:
            self._notice(drive, tick.lines)

    def _notice(self, drive: DriveRecorder, lines: bytes) -> None:
        found = triggers.noticed(lines)
        self._urgent |= found.urgent
        for trigger in found.triggers:
            self._latched_until_s = time.monotonic() + _AFTER_LATCH_S
            if len(self._pending) < _MOST_PENDING:
                self._pending.append((drive, trigger))

    def _drive_of(self, connection: GatewayConnection) -> DriveRecorder:
        """The connection's drive; that of an earlier one of the same run goes on."""
        if connection not in self.drives:
            drive = self._begun(connection.hello or {})
            connection.forget_hello()
            others = {one: its for one, its in self.drives.items() if its is not drive}
            self.drives = others | {connection: drive}
        return self.drives[connection]

    def _begun(self, hello: Mapping[str, Any]) -> DriveRecorder:
        run = hello["run"]
        if run not in self._runs:
            number, self.ring.next_drive = self.ring.next_drive, self.ring.next_drive + 1
            drives = self._options.folder / layout.DRIVES
            self._runs[run] = DriveRecorder(
                drives, number, hello, self.totals, self.disk, self.ring.ended, self.signer
            )
            written = self.drives.values()
            for old in [one for one in self._runs if self._runs[one] not in written][:-_MOST_RUNS]:
                del self._runs[old]
        return self._runs[run]

    def _close(self, connection: GatewayConnection) -> None:
        drive = self.drives.get(connection)
        if drive is not None:
            with self._abandoning(drive):
                closes = connection.ended_by_gateway
                why = "the gateway" if closes else "the recorder"
                drive.close(f"{why} ended the connection", closes)
            del self.drives[connection]

    @contextlib.contextmanager
    def _abandoning(self, drive: DriveRecorder) -> Iterator[None]:
        """End a segment whose file fails; one that only lacks room is written on later."""
        try:
            yield
        except OSError as error:
            if not is_full(error):
                drive.abandon(f"the disk failed: {error.strerror or error}")
            raise

    def _write(self, now_s: float) -> None:
        """Write and sync what is due; OSError leaves it due."""
        urgent = self._urgent
        if urgent or now_s >= self._member_s:
            for drive in self.drives.values():
                self._flush(drive)
            self._member_s = now_s + _MEMBER_S
            self._keep_cap()
        if urgent or now_s >= self._sync_s:
            for drive in self.drives.values():
                with self._abandoning(drive):
                    drive.sync()
            self._sync_s = now_s + _SYNC_S
            if self.drives:  # leave others their room on the disk
                missing = self._options.keep_free_bytes - room_bytes(self._options.folder)[1]
                self.ring.make_room(missing, keep=KEPT_WITHOUT_ROOM)
        if now_s < self._latched_until_s:
            self._member_s = self._sync_s = now_s + _SYNC_AFTER_LATCH_S
        self._urgent = False
        self._keep_incidents()

    def _flush(self, drive: DriveRecorder) -> None:
        try:
            with self._abandoning(drive):
                drive.flush()
        except OSError:
            raise
        except Exception as error:  # noqa: BLE001 - the others go on
            for connection in [one for one, its in self.drives.items() if its is drive]:
                self._give_up(connection, error)

    @property
    def drives_bytes(self) -> int:
        segments = [drive.segment for drive in tuple(self.drives.values())]
        return self.ring.size + sum(one.size for one in segments if one is not None)

    def _keep_cap(self) -> None:
        """Remove the oldest above the cap, so that only what is being written is beyond it."""
        self.ring.make_room(self.drives_bytes - self._options.max_bytes)

    def _keep_incidents(self) -> None:
        """Make the incidents that were noticed; OSError leaves them to be made."""
        if self._requested:
            self._requested = False
            what = self._given_reason() or "somebody asked to keep this"
            wanted = Trigger(layout.REQUESTED, layout.REQUESTED, what)
            self._pending += [(drive, wanted) for drive in self.drives.values()]
        while self._pending:
            self._keep_incident(*self._pending[0])
            self._pending.popleft()
        self.incidents.forget_ended()

    def _keep_incident(self, drive: DriveRecorder, trigger: Trigger | None) -> None:
        """Make one, or give it up where it cannot be made; OSError where the disk is at fault."""
        try:
            if trigger is None:
                self.incidents.segment_began(drive)
            else:
                self.incidents.begin(trigger, drive)
        except FileNotFoundError:
            pass  # somebody removed it meanwhile
        except OSError as error:
            if error.errno in _NO_LINKS:
                self._say_no_links(error)
            elif is_of_a_name(error):
                self._give_up_incident(trigger, error.strerror or repr(error)[:200])
            else:
                raise
        except Exception as error:  # noqa: BLE001 - later ones are made
            self._give_up_incident(trigger, repr(error)[:200])

    def _give_up_incident(self, trigger: Trigger | None, why: str) -> None:
        """It cannot be made, and not for want of a disk: those that follow are."""
        kind = "the open incident" if trigger is None else f"the incident {trigger.kind}"
        self.refusals.note("incident", f"{kind} cannot be kept and is given up: {why}")

    def _say_no_links(self, error: OSError) -> None:
        """Once: what is recorded goes on."""
        if not self._links_missing:
            self._links_missing = True
            self._say(
                f"no incident can be kept: {error.strerror or error}; drives and incidents must lie"
                " on one file system that has hard links"
            )

    def _given_reason(self) -> str:
        """Why somebody asked; empty where he gave no reason."""
        path = self._options.folder / layout.INCIDENTS / layout.REASON_FILE
        try:
            text = path.read_text(errors="replace")
            path.unlink()
        except OSError:
            return ""
        return layout.plain_reason(text)
