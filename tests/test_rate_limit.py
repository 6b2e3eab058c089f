"""Bursts and then one after the other; one line of a kind in a second, the others counted."""

import pytest

from vcu_gateway.rate_limit import LogRateLimit, TokenBucket

S, MS = 1_000_000_000, 1_000_000


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
    assert len(limit._kinds) == 100
    assert limit.admit(999, 1000) is None, "the latest are remembered"


@pytest.mark.parametrize(("late_ns", "at_once"), [(0, 3), (9 * MS, 3), (100 * MS, 3)])
def test_a_token_bucket_is_a_burst_and_then_one_after_the_other(late_ns, at_once):
    bucket, now_ns = TokenBucket(10 * MS, 3, 1000), 1000 + late_ns
    taken = 0
    while bucket.taken(now_ns):
        taken += 1
    assert taken == at_once
    assert not bucket.taken(now_ns + 10 * MS - 1)
    assert bucket.ready_ns == now_ns + 10 * MS
