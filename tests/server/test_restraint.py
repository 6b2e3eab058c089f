"""One line of a kind in a second; what was held back is counted, and the memory is bounded."""

from vcu_gateway.server.restraint import LogRateLimit

S = 1_000_000_000


def test_the_first_of_a_kind_is_told_and_the_next_ones_are_counted():
    restraint = LogRateLimit()
    assert restraint.untold("a", 0) == 0
    assert restraint.untold("a", 1) is None
    assert restraint.untold("a", S - 1) is None
    assert restraint.untold("a", S) == 2
    assert restraint.untold("a", 2 * S) == 0


def test_kinds_do_not_hold_each_other_back():
    restraint = LogRateLimit()
    assert restraint.untold("a", 0) == restraint.untold("b", 0) == 0


def test_it_remembers_only_so_many_kinds():
    restraint = LogRateLimit()
    for kind in range(1000):
        assert restraint.untold(kind, kind) == 0
    assert len(restraint._told_ns) == 100
    assert restraint.untold(999, 1000) is None, "the latest are remembered"
