from collections import Counter
from itertools import takewhile

from bench.traffic import NOMINAL_PER_S, SATURATED_PER_S, codec, second_at_rest, timetable

from vcu_gateway.core.receive import OWN_NODE

ONE_S_NS = 1_000_000_000


def within_a_second(per_s):
    return [frame for _, frame in takewhile(lambda due: due[0] < ONE_S_NS, timetable(per_s))]


def test_a_second_has_every_message_as_often_as_the_protocol_says():
    sent = Counter(
        int.from_bytes(frame[:4], "little") & 0x1FFF_FFFF for _, frame in second_at_rest(False)
    )
    for message in codec().protocol.received_by(OWN_NODE):
        assert sent.pop(message.can_id) == 1000 // message.period_ms, message.name
    assert not sent


def test_nominal_and_saturated_traffic_have_their_rates():
    assert len(within_a_second(NOMINAL_PER_S)) == NOMINAL_PER_S
    assert abs(len(within_a_second(SATURATED_PER_S)) - SATURATED_PER_S) <= 1
