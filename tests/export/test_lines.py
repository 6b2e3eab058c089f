"""Lines of a plot: peaks stay, gaps stay, and what is packed comes back."""

import zlib
from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.export.report import GAP, CodeLine, LineBuilder, packed

CODES = st.integers(-(1 << 31) + 1, (1 << 31) - 1)


def built(count: int, samples: list[tuple[int, int]], hold: int = 0) -> CodeLine:
    builder = LineBuilder(count)
    builder.add([bucket for bucket, _ in samples], [code for _, code in samples])
    return builder.line(hold)


def points(line: CodeLine) -> list[tuple[int, int]]:
    return list(zip(line.earlier, line.later, strict=True))


@given(st.lists(CODES, min_size=1, max_size=12))
def test_a_bucket_has_its_extremes_in_the_order_in_which_they_came(codes):
    [(first, second)] = points(built(1, [(0, code) for code in codes]))
    assert {first, second} == {min(codes), max(codes)}
    if first != second:
        last = len(codes) - 1 - codes[::-1].index(first)
        assert codes.index(first) < len(codes) - 1 - codes[::-1].index(second) or last == 0


def test_a_value_is_held_while_it_is_fresh_and_then_there_is_a_gap():
    line = built(6, [(1, 7)], hold=2)
    assert list(line.later) == [GAP, 7, 7, 7, GAP, GAP]


@given(st.lists(st.tuples(st.integers(0, 9), CODES), max_size=40))
def test_half_the_buckets_keep_every_extreme(samples):
    samples.sort(key=lambda one: one[0])
    fine, coarse = built(10, samples), built(5, [(bucket // 2, code) for bucket, code in samples])
    assert [set(one) for one in points(fine.halved())] == [set(one) for one in points(coarse)]


def test_an_odd_number_of_buckets_is_halved_too():
    assert points(built(3, [(0, 1), (2, 5)]).halved()) == [(1, 1), (5, 5)]


def test_a_line_is_constant_empty_or_neither():
    assert built(3, [(1, 4)]).constant == 4
    assert built(3, [(1, 4), (2, 5)]).constant is None
    assert built(3, []).empty
    assert not built(3, [(1, 0)]).empty


def unpacked(lines: list[CodeLine]) -> list[list[int]]:
    """What the page's script does."""
    result = packed(lines)
    data, place, found = zlib.decompress(result.data), 0, []
    for line, layout in zip(lines, result.layouts, strict=True):
        count = len(line.later) * (2 if layout["d"] else 1)
        size = (count - 1) * layout["w"]
        raw, place = data[place : place + size], place + size
        numbers = array({2: "h", 8: "q"}[layout["w"]])
        numbers.frombytes(
            bytes(raw[k * (count - 1) + i] for i in range(count - 1) for k in range(layout["w"]))
        )
        codes = [layout["a"]]
        for difference in numbers:
            codes.append(codes[-1] + difference)
        for first, length in layout["g"]:
            codes[first : first + length] = [GAP] * length
        found.append(codes)
    return found


@given(st.lists(st.lists(st.one_of(CODES, st.just(GAP)), min_size=5, max_size=5), max_size=4))
def test_what_is_packed_comes_back(many):
    lines = [CodeLine(array("i", codes), array("i", codes)) for codes in many]
    assert unpacked(lines) == many


@pytest.mark.parametrize("width", [100, 100_000])
def test_two_points_a_bucket_come_back(width):
    line = CodeLine(array("i", [0, width, GAP]), array("i", [width, 3, GAP]))
    assert unpacked([line]) == [[0, width, width, 3, GAP, GAP]]
