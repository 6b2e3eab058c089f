"""The mistakes that the mutation run makes."""

import pytest

from tests.mutation.operators import mutants


@pytest.mark.parametrize(
    ("source", "changed"),
    [
        ("x = a < b", {"x = a <= b", "x = a >= b"}),
        ("x = a + b", {"x = a - b"}),
        ("x = not a", {"x = a"}),
        ("x = a and b", {"x = a or b", "x = a", "x = b"}),
        ("LIMIT = 50", {"LIMIT = 51", "LIMIT = 49"}),
        ("x = True", {"x = False"}),
        ("x = min(a, b)", {"x = max(a, b)"}),
        ("TABLE = (A, B)", {"TABLE = (B,)", "TABLE = (A,)", "TABLE = (B, B)", "TABLE = (A, A)"}),
        ("def f():\n    return a", {"def f():\n    return None", "def f():\n    return True"}),
        ("def f():\n    g()", {"def f():\n    pass"}),
        ("def f():\n    self.x = a", {"def f():\n    pass"}),
        ("def f(x: 1) -> 2:\n    '''Text.'''", set()),
        ("from a import b", set()),
    ],
)
def test_a_source_has_exactly_these_mutants(source, changed):
    assert {mutant.source for mutant in mutants(source)} == changed


def test_a_mutant_says_where_it_is_and_what_it_changed():
    first = next(mutants("class C:\n\n    def f(self):\n        return a == b"))
    assert first.line == 4
    assert first.key == "C.f: return a == b => return None"
    assert first.diff == "-return a == b\n+return None"
