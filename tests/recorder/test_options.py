"""Options of the recorder."""

import pytest

from vcu_gateway.recorder import size_bytes


@pytest.mark.parametrize(
    ("text", "expected"),
    [("4G", 4 << 30), ("512M", 512 << 20), ("100k", 100 << 10), ("7", 7), ("1GiB", 1 << 30)],
)
def test_a_size_is_a_number_with_a_unit(text, expected):
    assert size_bytes(text) == expected


@pytest.mark.parametrize("text", ["", "G", "-1", "1.5G", "4X", "4 G", "٤"])
def test_anything_else_is_no_size(text):
    with pytest.raises(ValueError, match="is no size such as 4G"):
        size_bytes(text)
