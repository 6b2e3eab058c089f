"""A drive as the recorder's own parts write it, without a process: links, digests, its end."""

import errno
import hashlib
import itertools
import json
import os
import socket
import subprocess
from typing import Any

import pytest

from tests.recorder.gateway import (
    account,
    breaks,
    core_lines,
    drives,
    incidents,
    members,
    recorded_frames,
)
from vcu_gateway.recorder.drive import DriveRecorder, ticks_of
from vcu_gateway.recorder.receiver import Backlog, DatagramReceiver
from vcu_gateway.recorder.ring import Disk, Ring
from vcu_gateway.recorder.senders import Refusals, TapListener
from vcu_gateway.recorder.signing import Signer
from vcu_gateway.recording import chain, datagram, layout, signature
from vcu_gateway.recording.chain import FaultKind, Linked
from vcu_gateway.recording.datagram import CoreLineError, TickHeader
from vcu_gateway.recording.members import NO_LINK, packed
from vcu_gateway.recording.recorder_status import RecorderTotals
from vcu_gateway.recording.segment import begin_of

HELLO: dict[str, Any] = {
    "run": "1f3a9c2e4b",
    "boot": "b",
    "channel": "can0",
    "clock": {"monotonic_ns": 5 * 10**9, "wall_ns": 1_763_920_000 * 10**9},
    "config": "bus: {channel: can0}\n",
    "dbc": 'VERSION ""\n',
}
FRAMES = 18


class Drive:
    """A drive recorder and its gateway's ticks.

    Attributes:
        recorder: the one that writes now.
        frames, ticks: handed on so far.
    """

    def __init__(self, folder, signer=None):
        self.drives = folder / layout.DRIVES
        self.sequence = itertools.count(1)
        self.frames = self.ticks = self.in_segment = 0
        self.signer = signer
        self.start_recorder()

    def start_recorder(self):
        """Another process: it knows what is on the disk."""
        self.recorder = DriveRecorder(
            self.drives, 1, HELLO, RecorderTotals(), Disk(print), lambda *_: None, self.signer
        )

    @property
    def folder(self):
        return self.recorder.folder

    def tick(self, begins=False, frames=FRAMES):
        """One tick; its checkpoint before it where it begins a segment."""
        self.in_segment = frames if begins else self.in_segment + frames
        checkpoint = {"checkpoint": {"ticks": self.ticks}, "f": 0}
        lines = json.dumps(checkpoint, separators=(",", ":")) + "\n" if begins else ""
        lines += f'{{"f":{self.in_segment},"tick":{self.ticks},"frames":[],"ok":[]}}\n'
        self.frames += frames
        self.ticks += 1
        header = TickHeader(next(self.sequence), self.frames, 0, 0)
        own = [datagram.packed_frame(n, 0x123, False, bytes(8)) for n in range(frames)]
        return self.recorder.take(datagram.tick_parts(datagram.packed_tick(header, own, lines)))

    def second(self, begins=False):
        """Three ticks and a flush."""
        self.tick(begins)
        self.tick()
        self.tick()
        self.recorder.flush()


@pytest.fixture
def drive(tmp_path):
    """A drive of one segment, being written."""
    made = Drive(tmp_path)
    for begins in (True, False, False):
        made.second(begins)
    return made


def linked(folder):
    return [part for part in chain.walk(layout.segments(folder)) if isinstance(part, Linked)]


def ends(folder):
    lines = [line for segment in layout.segments(folder) for line in core_lines(segment)]
    return [line["end"] for line in lines if "end" in line]


def begins(folder):
    return [core_lines(segment)[1]["begin"] for segment in layout.segments(folder)]


def test_every_member_names_the_one_before_it_over_all_segments(drive):
    drive.second(begins=True)
    drive.recorder.close("the connection ended", closes=True)
    found = linked(drive.folder)
    assert breaks(drive.folder) == []
    assert found[0].member.link == NO_LINK
    assert {one.path for one in found} == set(drive.folder.glob("*.gz"))
    names = ["core" in one.path.name for one in found if one.segment == 1]
    assert names == [True, False, True, False, True, False, True, True]


def test_a_segment_says_its_number_and_the_digests_of_the_files_beside_it(drive):
    drive.second(begins=True)
    drive.recorder.flush()
    first, second = begins(drive.folder)
    files = {
        path.name: path.read_bytes() for path in drive.folder.iterdir() if "gz" not in path.name
    }
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    assert set(digests) == {"drive.json", "config.yaml", "vcu.dbc"}
    assert first["files"] == second["files"] == digests
    assert (first["segment"], second["segment"]) == (1, 2)
    assert "signer" not in first


def test_only_the_gateways_own_end_closes_the_drive(drive):
    drive.second(begins=True)
    drive.recorder.close("the connection ended", closes=False)
    drive.second(begins=True)
    drive.tick()
    drive.recorder.close("the connection ended", closes=True)
    told = [(one["ticks"], one["frames"], one["closes"]) for one in ends(drive.folder)]
    assert told == [(9, 9 * FRAMES, False), (3, 3 * FRAMES, False), (4, 4 * FRAMES, True)]


@pytest.mark.parametrize("tears", ["nothing", "core", "frames", "both"])
def test_the_next_recorder_goes_on_with_the_chain_of_one_that_was_killed(drive, tears):
    files = layout.segments(drive.folder)[0]
    torn = {"nothing": (), "core": (files.core,), "frames": (files.frames,), "both": files.paths}
    for path in torn[tears]:
        with path.open("ab") as file:
            file.write(path.read_bytes()[:50])
    os.close(drive.recorder._hold)
    drive.start_recorder()
    drive.second(begins=True)
    drive.recorder.close("the connection ended", closes=True)
    assert {one.kind for one in breaks(drive.folder)} <= {FaultKind.TORN}
    assert len(breaks(drive.folder)) == len(torn[tears])


def test_a_recorder_killed_between_both_files_of_a_flush_leaves_a_chain(drive):
    core = layout.segments(drive.folder)[0].core
    before = core.stat().st_size
    drive.second()
    os.truncate(core, before)  # only the frames were written
    os.close(drive.recorder._hold)
    drive.start_recorder()
    drive.second(begins=True)
    assert breaks(drive.folder) == []


@pytest.mark.parametrize("part", [0, 20])
def test_a_disk_that_is_full_between_both_files_breaks_no_link(drive, monkeypatch, part):
    write, room = os.write, [1]

    def full(descriptor, data):
        if room[0] > 0:
            room[0] -= 1
            return write(descriptor, data)
        if part and room[0] == 0:
            room[0] -= 1
            return write(descriptor, data[:part])
        raise OSError(errno.ENOSPC, "No space left on device")

    drive.tick()
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space"):
            drive.recorder.flush()
    drive.second()
    drive.recorder.close("the connection ended")
    assert breaks(drive.folder) == []
    assert recorded_frames(layout.segments(drive.folder)[0]) == drive.frames


def test_a_file_that_fails_is_left_and_the_chain_goes_on_in_the_next_segment(drive, monkeypatch):
    drive.tick()
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda *_: (_ for _ in ()).throw(OSError(errno.EIO, "EIO")))
        with pytest.raises(OSError, match="EIO"):
            drive.recorder.flush()
    drive.recorder.abandon("the disk failed: EIO")
    drive.second(begins=True)
    assert breaks(drive.folder) == []


def test_files_that_somebody_removed_while_they_were_written_are_missing_in_the_chain(drive):
    for path in layout.segments(drive.folder)[0].paths:
        path.unlink()
    with pytest.raises(FileNotFoundError):
        drive.recorder.sync()
    drive.recorder.abandon("somebody removed it")
    drive.second(begins=True)
    (found,) = breaks(drive.folder)
    assert (found.is_beginning, found.segment) == (True, 2)


def test_a_recorder_goes_on_with_what_one_without_links_began(drive):
    drive.recorder.close("the recorder stopped")
    for path in layout.segments(drive.folder)[0].paths:
        parts = [packed(one.data, one.first_line, one.wall_s) for one in members(path)]
        path.write_bytes(b"".join(parts))
    drive.start_recorder()
    drive.second(begins=True)
    assert breaks(drive.folder) == []
    assert {one.member.link is None for one in linked(drive.folder) if one.segment == 1} == {True}


def test_a_tick_in_an_events_fields_is_counted_once():
    line = b'{"f":3,"tick":1,"events":[["x","info",{"a":1,"tick":5}]]}\n'
    assert ticks_of(line * 2) == 2


def test_a_begin_whose_losses_are_no_numbers_is_none():
    begin = {"frames": 0, "ticks": 0, "wall_ns": 0}
    for lost in ("1", None, {"frames": 1e999, "ticks": "7", "gaps": 1}):
        with pytest.raises(CoreLineError, match="no usable begin"):
            begin_of([{"begin": {**begin, "lost": lost}}])
    lost = {"frames": 3, "ticks": 2, "gaps": 1}
    assert begin_of([{"begin": {**begin, "lost": lost}}]).lost == (3, 2, 1)


@pytest.mark.parametrize("ended_by", ["gateway", "recorder", "error"])
def test_the_recorder_knows_who_ended_a_connection(ended_by, tmp_path):
    wake_up, awake = socket.socketpair()
    listener = TapListener(tmp_path / "tap.sock", {}, os.getpid())
    refusals = Refusals(lambda _: None)
    backlog = Backlog(1 << 20)
    receiver = DatagramReceiver(listener, wake_up, backlog, lambda: None, {os.geteuid()}, refusals)
    gateway = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    gateway.connect(str(tmp_path / "tap.sock"))
    receiver.gather(0.0)
    (connection,) = receiver.connections
    if ended_by == "gateway":
        gateway.close()
    elif ended_by == "error":
        connection._sock.send(b"unread: the kernel answers with ECONNRESET")
        gateway.close()
    else:
        gateway.send(b"\x07 is no datagram of a gateway")
    receiver.gather(0.0)
    assert receiver.connections == []
    assert connection.ended_by_gateway is (ended_by == "gateway")
    receiver.close()
    listener.close()
    for one in (gateway, wake_up, awake):
        one.close()


@pytest.fixture
def key(tmp_path):
    """A key without a passphrase."""
    command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / "key"]
    subprocess.run(command, check=True)
    return tmp_path / "key"


def signing(tmp_path, key):
    said = []
    return Signer(key, tmp_path / layout.INCIDENTS, said.append), said


def test_each_segment_that_ended_is_signed_and_says_by_which_key(tmp_path, key):
    signer, said = signing(tmp_path, key)
    drive = Drive(tmp_path, signer)
    drive.second(begins=True)
    drive.second(begins=True)
    drive.recorder.close("the connection ended", closes=True)
    signer.stop(10)
    assert said == []
    assert signer.failures == 0
    assert {one["signer"] for one in begins(drive.folder)} == {signer.fingerprint}
    for number in (1, 2):
        last = [one for one in linked(drive.folder) if one.segment == number][-1]
        text = signature.link_text(HELLO["run"], number, last.member.digest)
        path = drive.folder / signature.link_name(number)
        assert path.read_bytes() == text
        made = path.with_name(path.name + signature.SUFFIX)
        assert signature.verify(text, made).fingerprint == signer.fingerprint
    Ring(drive.drives).make_room(1 << 30)
    assert not drive.folder.exists()


def test_an_incident_is_signed_and_gets_the_signatures_of_its_segments(tmp_path, key):
    signer, _ = signing(tmp_path, key)
    drive = Drive(tmp_path, signer)
    drive.second(begins=True)
    drive.second(begins=True)
    incident = tmp_path / layout.INCIDENTS / "20261123T180612Z-x"
    files = [path for one in layout.segments(drive.folder) for path in one.paths]
    layout.create_folder(incident, {layout.INCIDENT_FILE: json.dumps({"a": 1}).encode()}, files)
    signer.incident_made(incident, drive.folder)
    drive.second(begins=True)  # the second segment ends after the incident was made
    drive.recorder.close("the connection ended", closes=True)
    signer.stop(10)
    names = {path.name for path in incident.iterdir() if "gz" not in path.name}
    links = {f"000{number}.link{suffix}" for number in (1, 2) for suffix in ("", ".sig")}
    assert names == {"incident.json", "incident.json.sig"} | links
    text = (incident / layout.INCIDENT_FILE).read_bytes()
    assert signature.verify(text, incident / "incident.json.sig").fingerprint == signer.fingerprint


def test_a_key_that_cannot_sign_is_said_once_and_counted_and_recording_goes_on(tmp_path):
    signer, said = signing(tmp_path, tmp_path / "no-such-key")
    drive = Drive(tmp_path, signer)
    drive.second(begins=True)
    drive.second(begins=True)
    drive.recorder.close("the connection ended", closes=True)
    signer.stop(10)
    assert breaks(drive.folder) == []
    assert signer.failures == 3
    (sentence,) = said
    assert sentence.startswith("a recording is not signed: ")
    assert not list(drive.folder.glob("*.link*"))


def test_the_program_says_once_that_it_cannot_sign_and_records(recorder, gateway, tmp_path):
    process = recorder("--sign-key", tmp_path / "no-such-key")
    vehicle = gateway()
    vehicle.drive(0.2)
    vehicle.close()
    assert process.stop() == 0, process.errors
    (drive,) = drives(tmp_path)
    assert account(drive) == (vehicle.frames, 0)
    assert process.errors.count("a recording is not signed: ") == 1
    assert process.status["totals"]["signing_failures"] == 2


def test_the_program_signs_drive_and_incident_with_its_key(recorder, gateway, tmp_path, key):
    process = recorder("--sign-key", key)
    vehicle = gateway()
    vehicle.drive(0.2)
    vehicle.latch()
    vehicle.close()
    assert process.stop() == 0, process.errors
    assert process.status["totals"]["signing_failures"] == 0
    (drive,), (incident,) = drives(tmp_path), incidents(tmp_path)
    assert account(drive) == (vehicle.frames, 0)
    assert ends(drive)[0]["closes"] is True
    for text in (drive / "0001.link", incident / "0001.link", incident / "incident.json"):
        made = text.with_name(text.name + signature.SUFFIX)
        assert signature.verify(text.read_bytes(), made).fingerprint == signature.fingerprint(key)
