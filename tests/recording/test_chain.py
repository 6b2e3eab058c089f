"""Chain: the order of writing is found by links alone, and every break of it has its place."""

import hashlib
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from vcu_gateway.recording import chain, layout
from vcu_gateway.recording.chain import Break, FaultKind, Linked
from vcu_gateway.recording.members import NO_LINK, MemberDamage, digest_of, packed, read_members

ROOT = Path(__file__).resolve().parents[2]
SEGMENTS, SECONDS = 3, 6


def write(folder, order, first_link=NO_LINK, seconds=range(99)):
    """Members of `(segment, name, lines)` in this order, chained; a link of None: not chained."""
    link, lines = first_link, {}
    for place, (segment, name, count) in enumerate(order):
        path = folder / name(segment)
        data = b"".join(b"%d %d\n" % (place, line) for line in range(count))
        member = packed(data, lines.get(path, 0), seconds[place], link)
        lines[path] = lines.get(path, 0) + count
        with path.open("ab") as file:
            file.write(member)
        link = link and digest_of(member)
    return link


def drive_order():
    """As a recorder flushes: a checkpoint, then frames and core lines, now and then one alone."""
    for segment in range(1, SEGMENTS + 1):
        yield segment, layout.core_name, 2
        for second in range(SECONDS):
            if second != 2:
                yield segment, layout.frames_name, 5
            if second != 4:
                yield segment, layout.core_name, 3


@pytest.fixture
def drive(tmp_path):
    """A chained drive of three segments."""
    write(tmp_path, drive_order())
    return tmp_path


def breaks(folder):
    return [part for part in chain.walk(layout.segments(folder)) if isinstance(part, Break)]


def linked(folder):
    return [part for part in chain.walk(layout.segments(folder)) if isinstance(part, Linked)]


def offsets(path):
    return [part.offset for part in read_members(path)]


def cut(path, first, last=None):
    """Take whole members out of a file."""
    data, begins = path.read_bytes(), [*offsets(path), path.stat().st_size]
    path.write_bytes(data[: begins[first]] + data[begins[first + 1 if last is None else last] :])
    return begins[first]


def change(path, which):
    """Write another member of as many lines in place of one, with its link."""
    parts, data = list(read_members(path)), path.read_bytes()
    old = parts[which]
    new = packed(old.data.replace(b"0", b"7"), old.first_line, old.wall_s, old.link)
    path.write_bytes(data[: old.offset] + new + data[old.offset + old.size :])
    return old.offset


def test_members_come_in_the_order_in_which_they_were_written(drive):
    found = linked(drive)
    assert breaks(drive) == []
    assert [one.member.wall_s for one in found] == list(range(len(list(drive_order()))))


def test_the_end_is_the_member_that_the_next_one_names(tmp_path):
    link = write(tmp_path, drive_order())
    assert chain.end(tmp_path).member.digest == link
    (tmp_path / layout.frames_name(9)).touch()
    assert chain.end(tmp_path).member.digest == link


def test_a_torn_end_breaks_no_link(drive):
    path = drive / layout.frames_name(2)
    size = path.stat().st_size
    with path.open("ab") as file:
        file.write(packed(b"never whole\n", 25, 0, NO_LINK)[:40])
    (torn,) = breaks(drive)
    assert (torn.kind, torn.path, torn.offset) == (FaultKind.TORN, path, size)


@pytest.mark.parametrize("name", [layout.frames_name, layout.core_name])
@pytest.mark.parametrize("which", range(SECONDS - 2))
def test_a_changed_member_is_told_with_its_place(drive, name, which):
    path = drive / name(2)
    offset = change(path, which)
    (found,) = breaks(drive)
    assert found.kind is FaultKind.CHANGED
    assert (found.path, found.offset) == (path, offset)


@pytest.mark.parametrize("name", [layout.frames_name, layout.core_name])
def test_a_member_missing_in_the_middle_is_told_with_its_lines(drive, name):
    path = drive / name(2)
    offset = cut(path, 1)
    (found,) = breaks(drive)
    assert (found.kind, found.path, found.offset) == (FaultKind.MISSING, path, offset)
    assert "lines before it are missing" in found.what


def test_the_rest_is_in_order_where_members_of_the_same_second_are_missing(tmp_path):
    write(tmp_path, drive_order(), seconds=[7] * 99)
    order = [one.member.digest for one in linked(tmp_path)]
    cut(tmp_path / layout.frames_name(2), 0, 2)
    assert {one.kind for one in breaks(tmp_path)} == {FaultKind.MISSING}
    left = [one.member.digest for one in linked(tmp_path)]
    assert left == [digest for digest in order if digest in left]


def test_a_flush_between_two_looks_at_the_sizes_breaks_nothing(tmp_path, monkeypatch):
    order, stat = list(drive_order()), Path.stat
    link = write(tmp_path, order[:1])
    (tmp_path / layout.frames_name(1)).touch()
    looks = []

    def stat_while_it_is_written(path, **how):
        looks.append(path)
        if len(looks) == 2:  # after that at the frames, before that at the core lines
            write(tmp_path, order[1:3], link)
        return stat(path, **how)

    monkeypatch.setattr(Path, "stat", stat_while_it_is_written)
    assert breaks(tmp_path) == []


def test_an_end_that_is_missing_in_a_middle_segment_is_told(drive):
    cut(drive / layout.core_name(2), SECONDS - 1)
    (found,) = breaks(drive)
    assert (found.kind, found.segment) == (FaultKind.MISSING, 3)
    assert found.what == "the end of segment 2 is missing, or was changed"


def test_a_segment_that_is_missing_in_the_middle_is_told(drive):
    for name in (layout.frames_name, layout.core_name):
        (drive / name(2)).unlink()
    (found,) = breaks(drive)
    assert (found.kind, found.segment) == (FaultKind.MISSING, 3)
    assert "segment 2 is not there" in found.what


def test_first_segments_that_are_missing_are_the_beginning(drive):
    for name in (layout.frames_name, layout.core_name):
        (drive / name(1)).unlink()
    (found,) = breaks(drive)
    assert (found.is_beginning, found.what) == (True, "segments before 2 are not there")
    cut(drive / layout.core_name(2), 0)
    assert breaks(drive)[0].is_beginning


def test_a_file_that_is_missing_is_told(drive):
    (drive / layout.frames_name(2)).unlink()
    assert {one.kind for one in breaks(drive)} == {FaultKind.MISSING}
    assert all(one.path == drive / layout.core_name(2) for one in breaks(drive)[:-1])


def test_members_of_two_drives_are_no_chain(drive, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    write(other, list(drive_order()), bytes([1]) * 32)
    (other / layout.core_name(2)).replace(drive / layout.core_name(2))
    assert breaks(drive)


def test_what_was_recorded_without_links_is_read_file_by_file(tmp_path):
    write(tmp_path, drive_order(), first_link=None)
    found = linked(tmp_path)
    assert breaks(tmp_path) == []
    assert {one.member.link for one in found} == {None}
    assert len(found) == len(list(drive_order()))
    assert chain.end(tmp_path).path == tmp_path / layout.core_name(SEGMENTS)


def test_a_newer_recorder_chains_what_an_older_one_began(tmp_path):
    order = [one for one in drive_order() if one[0] < SEGMENTS]
    write(tmp_path, order, first_link=None)
    end = chain.end(tmp_path).member.digest
    write(tmp_path, [one for one in drive_order() if one[0] == SEGMENTS], end)
    assert breaks(tmp_path) == []


def test_links_that_end_in_the_middle_are_told(tmp_path):
    write(tmp_path, [one for one in drive_order() if one[0] < SEGMENTS])
    write(tmp_path, [one for one in drive_order() if one[0] == SEGMENTS], first_link=None)
    (found,) = breaks(tmp_path)
    assert (found.kind, found.segment) == (FaultKind.CHANGED, SEGMENTS)


def test_no_damage_leaves_the_chain_whole(drive):
    chance = random.Random(24)
    paths = [path for files in layout.segments(drive) for path in files.paths]
    for _ in range(200):
        path = chance.choice(paths)
        data = path.read_bytes()
        at, size = chance.randrange(len(data)), chance.randrange(1, 100)
        rubbish = chance.choice([chance.randbytes(size), bytes(size), b""])
        path.write_bytes(data[:at] + rubbish + data[at + size :])
        damaged = any(isinstance(part, MemberDamage) for part in read_members(path))
        assert damaged or breaks(drive) or path.read_bytes() == data
        path.write_bytes(data)


def test_what_is_no_regular_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (damage,) = read_members(tmp_path / "fifo")
    assert isinstance(damage, MemberDamage)
    assert "no regular file" in damage.what


def test_files_beside_the_members_have_digests_as_sha256sum_gives_them(tmp_path):
    (tmp_path / layout.CONFIG_FILE).write_text("bus: {}\n")
    done = subprocess.run(["sha256sum", tmp_path / layout.CONFIG_FILE], stdout=subprocess.PIPE)
    digest = done.stdout.split()[0].decode()
    assert chain.file_digests(tmp_path) == {layout.CONFIG_FILE: digest}


def test_a_description_has_the_digest_of_everything_else_in_it():
    text = '{"a":[1,"\\u00e4"],"b":{"c":null}}'
    digest = hashlib.sha256(text.encode()).hexdigest()
    described = {"b": {"c": None}, "a": [1, "\u00e4"]}
    assert layout.description_digest(described) == digest
    assert layout.description_digest({**described, "digest": digest}) == digest


def checked_by_the_pages_program(folder):
    """What the program on the page of the format says of a drive, and its exit code."""
    page = (ROOT / "docs" / "recordings-format.md").read_text()
    program = page.split("```python\n")[1].split("```")[0]
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_a_reader_made_from_the_page_alone_finds_what_this_one_finds(drive):
    last = chain.end(drive).member.digest.hex()
    assert checked_by_the_pages_program(drive) == (0, f"chained, up to {last}\n")
    with (drive / layout.frames_name(2)).open("ab") as file:
        file.write(packed(b"never whole\n", 25, 0, NO_LINK)[:40])
    code, said = checked_by_the_pages_program(drive)
    assert (code, "there is no whole member" in said) == (0, True)
    change(drive / layout.core_name(2), 1)
    code, said = checked_by_the_pages_program(drive)
    assert code == 1
    assert "0002.core.jsonl.gz: the chain is broken" in said
