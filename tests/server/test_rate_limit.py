"""One line of a kind in a second; what is suppressed is counted, and the memory is bounded."""

from vcu_gateway.server.rate_limit import LogRateLimit

S = 1_000_000_000


def test_the_first_of_a_kind_is_admitted_and_the_next_ones_are_counted():
    limit = LogRateLimit()
    assert limit.admit("a", 0) == 0
    assert limit.admit("a", 1) is None
    assert limit.admit("a", S - 1) is None
    assert limit.admit("a", S) == 2
    assert limit.admit("a", 2 * S) == 0


def test_kinds_do_not_suppress_each_other():
    limit = LogRateLimit()
    assert limit.admit("a", 0) == limit.admit("b", 0) == 0


def test_it_remembers_at_most_100_kinds():
    limit = LogRateLimit()
    for kind in range(1000):
        assert limit.admit(kind, kind) == 0
    assert len(limit._admitted_ns) == 100
    assert limit.admit(999, 1000) is None, "the latest are remembered"
