"""Signer: has ssh-keygen sign each segment's end and each incident, in a thread of its own.

Nothing waits for it: what cannot be signed is recorded all the same, said once and counted.
"""

import contextlib
import queue
import threading
from collections.abc import Callable
from pathlib import Path

from vcu_gateway import files
from vcu_gateway.recording import layout, signature
from vcu_gateway.recording.signature import SignatureError

_MOST_WAITING = 100


class Signer:
    """Signs with one key; `segment_ended`, `incident_made` and `stop` are the writer's.

    Attributes:
        fingerprint: of the key; None where it could not be read at the start.
        failures: how many signatures could not be made.
    """

    def __init__(self, key: Path, incidents: Path, say: Callable[[str], None]) -> None:
        self.fingerprint: str | None = None
        self.failures = 0
        self._key = key
        self._incidents = incidents
        self._say = say
        self._waiting: queue.Queue[Callable[[], None] | None] = queue.Queue(_MOST_WAITING)
        try:
            self.fingerprint = signature.fingerprint(key)
        except SignatureError as error:
            self._failed(error)
        self._thread = threading.Thread(target=self._run, name="signer", daemon=True)
        self._thread.start()

    def segment_ended(self, drive: Path, run: str, number: int, link: bytes) -> None:
        """Sign what the chain has come to; `link`: digest of the segment's last member."""
        self._put(lambda: self._sign_segment(drive, run, number, link))

    def incident_made(self, incident: Path, drive: Path) -> None:
        """Sign its description, and give it what is signed of its segments."""
        self._put(lambda: self._sign_incident(incident, drive))

    def stop(self, timeout_s: float) -> None:
        self._put(None)
        self._thread.join(timeout_s)

    def _put(self, job: Callable[[], None] | None) -> None:
        try:
            self._waiting.put_nowait(job)
        except queue.Full:
            self._failed(SignatureError("too much waits to be signed"))

    def _run(self) -> None:
        while (job := self._waiting.get()) is not None:
            try:
                job()
            except FileNotFoundError:
                pass  # somebody removed it meanwhile, or the recorder did for room
            except (OSError, SignatureError) as error:
                self._failed(error)

    def _failed(self, error: Exception) -> None:
        self.failures += 1
        if self.failures == 1:
            self._say(f"a recording is not signed: {error}; recording goes on")

    def _sign_segment(self, drive: Path, run: str, number: int, link: bytes) -> None:
        path, beside = made = signature.link_paths(drive, number)
        text = signature.link_text(run, number, link)
        signed = signature.sign(text, self._key)
        layout.write_new(path, text)  # without its signature it is never there for long
        layout.write_new(beside, signed)
        files.sync(drive)
        core = layout.core_name(number)
        for incident in layout.recorded_folders(self._incidents):
            if _is_same(incident / core, drive / core):
                layout.link_files(made, incident)

    def _sign_incident(self, incident: Path, drive: Path) -> None:
        path = incident / layout.INCIDENT_FILE
        made = signature.sign(path.read_bytes(), self._key)
        layout.write_new(Path(f"{path}{signature.SUFFIX}"), made)
        for segment in layout.segments(incident):
            with contextlib.suppress(FileNotFoundError):  # none yet, or none at all
                layout.link_files(signature.link_paths(drive, segment.number), incident)


def _is_same(path: Path, other: Path) -> bool:
    with contextlib.suppress(OSError):
        return path.samefile(other)
    return False
