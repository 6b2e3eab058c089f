"""Members: what is read of whole, torn and damaged files."""

import gzip
import os
import random
import subprocess
import zlib

import pytest

from vcu_gateway.recording import members
from vcu_gateway.recording.members import Member, MemberDamage, read_members
from vcu_gateway.recording.segment import MemberFile

LINES = 50


@pytest.fixture
def written(tmp_path):
    """A file of 20 members of 50 lines each, and the offsets of the members."""
    path = tmp_path / "0001.frames.log.gz"
    file = MemberFile(path)
    offsets = []
    for second in range(20):
        offsets.append(file.size)
        file.append(text_of(second), 1_700_000_000 + second)
    file.close()
    return path, offsets


def text_of(second):
    chance = random.Random(second)
    lines = (f"{second} {line} {chance.random()}\n" for line in range(LINES))
    return "".join(lines).encode()


def read(path):
    parts = list(read_members(path))
    whole = [part for part in parts if isinstance(part, Member)]
    damaged = [part for part in parts if isinstance(part, MemberDamage)]
    assert sum(part.size for part in parts) == path.stat().st_size
    return whole, damaged


def test_a_whole_file_is_read_as_it_was_written(written):
    path, offsets = written
    whole, damaged = read(path)
    assert damaged == []
    assert [one.data for one in whole] == [text_of(second) for second in range(20)]
    assert [one.offset for one in whole] == offsets
    assert [(one.first_line, one.lines) for one in whole] == [(50 * n, 50) for n in range(20)]
    assert [one.wall_s for one in whole] == [1_700_000_000 + second for second in range(20)]


def test_other_programs_read_it_as_one_text(written):
    path, _ = written
    text = b"".join(map(text_of, range(20)))
    assert gzip.decompress(path.read_bytes()) == text
    assert subprocess.run(["zcat", path], capture_output=True, check=True).stdout == text


def test_a_torn_end_costs_its_member(written):
    path, offsets = written
    data = path.read_bytes()
    for size in (offsets[-1] + 1, offsets[-1] + 31, offsets[-1] + 40, len(data) - 1):
        path.write_bytes(data[:size])
        whole, (torn,) = read(path)
        assert len(whole) == 19
        assert torn.torn
        assert torn.offset == offsets[-1]


def test_zeros_at_the_end_are_torn(written):
    path, _ = written
    with path.open("ab") as file:
        file.write(bytes(4096))
    whole, (torn,) = read(path)
    assert (len(whole), torn.torn, torn.what) == (20, True, "zeros that are no member")


def test_zeros_in_the_middle_cost_the_members_that_they_hit(written):
    path, offsets = written
    data = bytearray(path.read_bytes())
    data[offsets[5] + 10 : offsets[7] + 10] = bytes(offsets[7] - offsets[5])
    path.write_bytes(data)
    whole, (damage,) = read(path)
    assert [one.first_line // LINES for one in whole] == [*range(5), *range(8, 20)]
    assert not damage.torn
    assert (damage.offset, damage.size) == (offsets[5], offsets[8] - offsets[5])


def test_a_member_whose_lines_do_not_fit_its_checksum_is_damaged(written):
    path, offsets = written
    data = bytearray(path.read_bytes())
    data[offsets[4] - 6] ^= 1
    path.write_bytes(data)
    whole, (damage,) = read(path)
    assert [one.first_line // LINES for one in whole] == [*range(3), *range(4, 20)]
    assert damage.what == "50 lines cannot be read"


def test_any_damage_leaves_every_member_that_it_did_not_hit(written):
    path, offsets = written
    data, chance = path.read_bytes(), random.Random(7)
    ends = [*offsets[1:], len(data)]
    for _ in range(300):
        at, size = chance.randrange(len(data)), chance.randrange(1, 200)
        rubbish = chance.randbytes(size) if chance.random() < 0.5 else bytes(size)
        path.write_bytes(data[:at] + rubbish + data[at + size :])
        hit = {
            member
            for member, (begin, end) in enumerate(zip(offsets, ends, strict=True))
            if begin < at + size and at < end
        }
        whole, _ = read(path)
        left = {one.first_line // LINES: one.data for one in whole}
        assert set(range(20)) - hit <= set(left)
        assert all(data == text_of(second) for second, data in left.items())


def test_members_of_other_programs_are_read_too(tmp_path):
    path = tmp_path / "foreign.gz"
    path.write_bytes(gzip.compress(text_of(1)) + gzip.compress(text_of(2) * 5000))
    whole, damaged = read(path)
    assert damaged == []
    assert [(one.first_line, one.lines) for one in whole] == [(0, 50), (50, 250_000)]


def test_a_member_that_would_fill_the_memory_is_damage(tmp_path, monkeypatch):
    monkeypatch.setattr(members, "MAX_MEMBER_BYTES", 100_000)
    for data in (members.packed(b"\n" * 200_000, 0, 0), gzip.compress(b"\n" * 200_000)):
        path = tmp_path / "bomb.gz"
        path.write_bytes(data)
        whole, (damage,) = read(path)
        assert whole == []
        assert damage.size == len(data)


def test_a_header_that_claims_too_much_is_damage_and_not_read(tmp_path, monkeypatch):
    path = tmp_path / "claim.gz"
    path.write_bytes(members.packed(random.Random(1).randbytes(1000), 0, 0))
    monkeypatch.setattr(members, "MAX_MEMBER_BYTES", 500)
    assert [type(one) for one in read_members(path, lines_too=False)] == [MemberDamage]


def test_headers_that_all_claim_the_rest_of_the_file_are_read_once(tmp_path, monkeypatch):
    chance, count, step = random.Random(3), 3000, 100
    data = bytearray(chance.randbytes(count * step))
    for offset in range(0, len(data), step):
        size = len(data) - offset
        header = members.packed(b"x\n", 0, 0)[:24] + size.to_bytes(4, "little")
        data[offset : offset + 32] = header + zlib.crc32(header).to_bytes(4, "little")
    path, pread, read_bytes = tmp_path / "claims.gz", os.pread, []

    def counted(*arguments):
        found = pread(*arguments)
        read_bytes.append(len(found))
        return found

    path.write_bytes(data)
    monkeypatch.setattr(os, "pread", counted)
    assert not [one for one in read_members(path) if isinstance(one, Member)]
    assert sum(read_bytes) < count * 90_000  # 450 MB, were each read wholly


def test_an_empty_file_has_no_member_and_no_damage(tmp_path):
    (tmp_path / "empty.gz").touch()
    assert read(tmp_path / "empty.gz") == ([], [])


def test_a_header_of_ours_with_a_wrong_size_is_no_member(tmp_path):
    data = bytearray(members.packed(b"x\n", 0, 0))
    data[24:28] = (5).to_bytes(4, "little")
    data[28:32] = zlib.crc32(data[:28]).to_bytes(4, "little")
    (tmp_path / "short.gz").write_bytes(data)
    whole, (damage,) = read(tmp_path / "short.gz")
    assert (whole, damage.size) == ([], len(data))


def test_a_file_that_is_there_is_never_written_again(written):
    path, _ = written
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        MemberFile(path)
    assert path.read_bytes() == before
