"""The survivors that are explained are mutants of today's source."""

import tomllib

import pytest

from tests.mutation.operators import mutants
from tests.mutation.run import SURVIVORS, TESTS, path_of

ENTRIES = tomllib.loads(SURVIVORS.read_text(encoding="utf-8"))["survivor"]


@pytest.mark.parametrize("module", sorted({entry["module"] for entry in ENTRIES}))
def test_each_survivor_of_a_module_is_one_of_its_mutants(module: str) -> None:
    explained = {entry["key"] for entry in ENTRIES if entry["module"] == module}
    source = path_of(module).read_text("utf-8")
    scopes = {key.partition(": ")[0] for key in explained}
    assert module in TESTS
    assert explained - {mutant.key for mutant in mutants(source, scopes)} == set()
