"""The mistakes that the oracle has to see can still be made."""

import pytest

from tests.oracle.mutate import REPOSITORY, Mistake, read


@pytest.mark.parametrize("mistake", read(), ids=lambda mistake: mistake.name)
def test_its_text_stands_once_in_its_file_and_reads_as_python(mistake: Mistake) -> None:
    text = (REPOSITORY / "src" / "vcu_gateway" / mistake.file).read_text("utf-8")
    assert text.count(mistake.old) == 1
    compile(text.replace(mistake.old, mistake.new), mistake.file, "exec")
