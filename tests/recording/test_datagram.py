"""Datagrams of the tap: packed and unpacked, and what damage does to them."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.recording.tapped import frames_of
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.recording import datagram
from vcu_gateway.recording.datagram import DatagramError, HelloPart, HelloText, TickHeader
from vcu_gateway.recording.tap import packed_frames

HEADER = TickHeader(sequence=7, frames=2**40, datagrams_lost=3, frames_lost=2**33)
LINES = '{"f":0,"tick":1,"frames":[]}\n{"f":2,"why":"größer"}\n'
FRAMES = st.builds(
    Frame,
    can_id=st.integers(0, 2**29 - 1),
    data=st.binary(max_size=64) | st.binary(min_size=8, max_size=8),
    arrival_ns=st.integers(-(2**63), 2**63 - 1),
    extended=st.booleans(),
    remote=st.booleans(),
    error=st.booleans(),
    own_echo=st.booleans(),
)


@given(frames=st.lists(FRAMES, max_size=20), lines=st.sampled_from(["", LINES]))
def test_a_tick_is_unpacked_as_it_was_packed(frames, lines):
    packed = datagram.packed_tick(HEADER, packed_frames(frames), lines)
    unpacked = datagram.tick_parts(packed)
    assert (unpacked.header, unpacked.lines.decode()) == (HEADER, lines)
    assert frames_of(unpacked.frames) == frames


def test_a_frame_of_eight_bytes_takes_22_bytes():
    (packed,) = packed_frames([Frame(0x40AD079, bytearray(8), 5)])
    assert packed.hex() == "0500000000000000" + "79d00a84" + "00" + "08" + "00" * 8


@pytest.mark.parametrize("config", ["", "x" * 63_900, "ö" * 80_000], ids=len)
def test_a_hello_of_any_size_is_put_together_again(config):
    hello = {"format": 1, "config": config}
    packed = list(datagram.packed_hello(hello))
    assert max(map(len, packed)) < 65_000
    parts, text = [datagram.unpack(one) for one in packed], HelloText()
    taken = [text.take(part) for part in parts if isinstance(part, HelloPart)]
    assert taken == [None] * (len(parts) - 1) + [hello]


@pytest.mark.parametrize(
    "text",
    [b"", b"{", b"[1]", b'{"format": 2}', b"\xff", b"[" * 100_000],
    ids=lambda text: text[:20],
)
def test_a_hello_that_is_none_is_refused(text):
    with pytest.raises(DatagramError, match="HELLO"):
        HelloText().take(HelloPart(True, text))


def test_a_hello_without_end_is_refused():
    text, part = HelloText(), HelloPart(False, bytes(64_000))
    assert [text.take(part) for _ in range(8)] == [None] * 8
    with pytest.raises(DatagramError, match="524288 bytes"):
        text.take(part)


def damaged(**changes):
    fields = {"kind": 2, "format": 1, "zero": 0} | changes
    good = datagram.packed_tick(HEADER, packed_frames([Frame(1, bytes(8), 5)] * 3), LINES)
    return bytes(fields.values()) + good[3:]


@pytest.mark.parametrize(
    ("packed", "reason"),
    [
        (b"", "too short"),
        (b"\x02\x01", "too short"),
        (damaged()[:20], "too short"),
        (damaged(format=2), "the format is 2"),
        (damaged(kind=3), "neither a HELLO nor a tick"),
        (damaged(zero=1), "neither a HELLO nor a tick"),
        (damaged(kind=1, zero=2), "neither a HELLO nor a tick"),
        (damaged()[:70], "frame 2 of 3"),
        (damaged()[:45], "frame 1 of 3"),
        (damaged()[:-1], "no end"),
        (damaged()[:51] + b"\x02" + damaged()[52:], "frame 1 of 3 is damaged"),
    ],
    ids=range(11),
)
def test_a_damaged_datagram_is_refused_with_its_reason(packed, reason):
    with pytest.raises(DatagramError, match=reason):
        datagram.unpack(packed)


@given(data=st.binary(max_size=200), place=st.integers(0, 200), kind=st.sampled_from([1, 2]))
def test_any_bytes_are_unpacked_or_refused_never_more(data, place, kind):
    good = damaged(kind=kind)
    mixed = good[:place] + data + good[place + len(data) :]
    for packed in (data, mixed):
        try:
            unpacked = datagram.unpack(packed)
            if isinstance(unpacked, HelloPart):
                HelloText().take(unpacked)
        except DatagramError:
            pass


def test_the_json_of_a_hello_is_one_object():
    (part,) = datagram.packed_hello({"format": 1})
    assert json.loads(part[3:]) == {"format": 1}
