"""The fields of a 29-bit identifier, and what makes two of them the same message."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.core import j1939

IDENTIFIERS = st.integers(0, j1939.ID_MASK)

# identifier -> (priority, EDP, DP, PF, PS, SA), PGN, destination; by hand from the source.
KNOWN = [
    (0x040AD092, (1, 0, 0, 10, 208, 146), 0x0A00, 208),
    (0x1808D0F4, (6, 0, 0, 8, 208, 244), 0x0800, 208),
    (0x040AD079, (1, 0, 0, 10, 208, 121), 0x0A00, 208),
    (0x1C0AD079, (7, 0, 0, 10, 208, 121), 0x0A00, 208),
    (0x0008A7D0, (0, 0, 0, 8, 167, 208), 0x0800, 167),
    (0x08F02DE2, (2, 0, 0, 240, 0x2D, 0xE2), 61485, None),
    (0x18FEF1FE, (6, 0, 0, 254, 241, 254), 65265, None),
    (0x18EFFF01, (6, 0, 0, 239, 255, 1), 0xEF00, 255),
    (0x1FFFFFFF, (7, 1, 1, 255, 255, 255), 0x3FFFF, None),
    (0x03000000, (0, 1, 1, 0, 0, 0), 0x30000, 0),
    (0, (0, 0, 0, 0, 0, 0), 0, 0),
]


@pytest.mark.parametrize(("can_id", "fields", "pgn", "destination"), KNOWN)
def test_an_identifier_has_the_fields_of_the_source(can_id, fields, pgn, destination):
    identifier = j1939.parse(can_id)
    assert identifier == fields
    assert identifier.pgn == pgn
    assert identifier.destination_address == destination


@given(IDENTIFIERS)
def test_splitting_loses_nothing(can_id):
    priority, *pages, pdu_format, pdu_specific, source = j1939.parse(can_id)
    joined = bytes([priority << 2 | pages[0] << 1 | pages[1], pdu_format, pdu_specific, source])
    assert int.from_bytes(joined) == can_id


@pytest.mark.parametrize("number", [-1, 1 << 29, 0x240AD079, 1 << 32])
def test_a_number_beyond_29_bits_is_no_identifier(number):
    with pytest.raises(ValueError, match="does not fit 29 bits"):
        j1939.parse(number)


@given(IDENTIFIERS, st.integers(0, 7))
def test_the_priority_makes_no_other_message(can_id, priority):
    changed = j1939.with_priority(can_id, priority)
    assert j1939.parse(changed) == j1939.parse(can_id)._replace(priority=priority)
    assert j1939.match_key(changed) == j1939.match_key(can_id)


@given(IDENTIFIERS, st.integers(0, 255))
def test_the_sender_makes_another_message_of_the_same_group(can_id, address):
    changed = can_id & ~0xFF | address
    assert j1939.group_key(changed) == j1939.group_key(can_id)
    assert (j1939.match_key(changed) == j1939.match_key(can_id)) == (can_id & 0xFF == address)


@given(IDENTIFIERS, IDENTIFIERS)
def test_identifiers_match_if_all_but_their_priority_is_equal(one, other):
    fields = [j1939.parse(can_id)[1:] for can_id in (one, other)]
    assert (j1939.match_key(one) == j1939.match_key(other)) == (fields[0] == fields[1])


@given(can_id=IDENTIFIERS, destination=st.integers(0, 255))
def test_a_group_to_another_node_differs_in_the_destination_alone(can_id, destination):
    fields = j1939.parse(can_id)
    group = j1939.parse(j1939.group_key_to(can_id, destination))
    assert group == fields._replace(priority=0, pdu_specific=destination, source_address=0)
