"""Tables of a terminal: aligned columns of text."""

from collections.abc import Iterable, Sequence

_GAP = "  "


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[int] = ()
) -> list[str]:
    """Lines with every column as wide as its widest cell; `right` are columns of numbers."""
    lines = [tuple(head), *(tuple(row) for row in rows)]
    widths = [max(len(row[column]) for row in lines) for column in range(len(head))]
    return [
        _GAP.join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in lines
    ]


def number(count: int) -> str:
    """A count with thousands apart."""
    return f"{count:,}"


def counted(count: int, what: str) -> str:
    """`1 tick`, `1,200 ticks`."""
    return f"{number(count)} {what}{'' if count == 1 else 's'}"


def duration(seconds: float) -> str:
    """Duration, as 1:02:03 or 12.3 s."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
