"""Lines of frames: the quick way and the slow one write the same."""

import io
import random

import can

from vcu_gateway.recording import datagram, segment
from vcu_gateway.recording.datagram import TickHeader
from vcu_gateway.recording.segment import frame_line, tick_lines

CLOCK_NS = 1_763_000_000_000_000_000


def tick_of(records):
    packed = [datagram.packed_frame(*record) for record in records]
    return datagram.tick_parts(datagram.packed_tick(TickHeader(1, 1, 0, 0), packed, ""))


def random_records(seed, lengths):
    chance = random.Random(seed)
    flags = (0, datagram.EXTENDED, datagram.EXTENDED | datagram.ERROR)
    for _ in range(200):
        can_id = chance.randrange(0x800) | chance.choice(flags)
        data = chance.randbytes(chance.choice(lengths))
        yield chance.randrange(10**15), can_id, chance.random() < 0.1, data


def test_the_quick_way_writes_what_the_slow_one_does():
    for seed, lengths in enumerate([[8], [0, 1, 7, 8], [8, 12, 64]]):
        records = list(random_records(seed, lengths))
        expected = "".join(
            frame_line("can0", at + CLOCK_NS, can_id, data, own)
            for at, can_id, own, data in records
        )
        for _ in range(2):  # the second time with every identifier known
            assert tick_lines("can0", tick_of(records), CLOCK_NS) == expected


def test_more_identifiers_than_are_kept_are_written_all_the_same():
    records = [(1, datagram.EXTENDED | number, False, bytes(8)) for number in range(10_000)]
    text = tick_lines("can0", tick_of(records), CLOCK_NS)
    assert [int(line.split()[2].split("#")[0], 16) for line in text.splitlines()] == list(
        range(10_000)
    )
    assert segment._around.cache_info().currsize <= 4096


def test_a_clock_that_stands_in_1970_is_written_with_nine_digits():
    text = tick_lines("can0", tick_of([(5, 0x123, False, bytes(8))]), 0)
    assert text == "(0.000000005) can0 123#0000000000000000 R\n"


def test_python_can_reads_the_lines():
    records = [(1, datagram.EXTENDED | 0x40AD079, False, bytes(range(8))), (2, 0x7FF, True, b"")]
    text = tick_lines("can0", tick_of(records), CLOCK_NS)
    first, second = can.CanutilsLogReader(io.StringIO(text))
    assert (first.arbitration_id, first.is_extended_id, first.is_rx) == (0x40AD079, True, True)
    assert bytes(first.data) == bytes(range(8))
    assert (second.arbitration_id, second.is_extended_id, second.is_rx) == (0x7FF, False, False)
