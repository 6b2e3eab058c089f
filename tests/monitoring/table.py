"""The table of all metrics in docs/monitoring/README.md.

`python -m tests.monitoring.table` writes it again.
"""

from tests.monitoring.paths import README
from vcu_gateway.exporter import FAMILIES

BEGIN = "<!-- metrics: python -m tests.monitoring.table -->\n"
END = "<!-- end of metrics -->\n"


def table() -> str:
    """A row for each family."""
    rows = ["| metric | labels | type | meaning |", "| --- | --- | --- | --- |"]
    for family in FAMILIES:
        labels = ", ".join(f"`{label}`" for label in family.labels)
        rows.append(f"| `{family.name}` | {labels} | {family.kind} | {family.help} |")
    return "\n".join(rows) + "\n"


def page(before: str) -> str:
    """The page with the table as it is now."""
    head, _, rest = before.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{table()}\n{END}{tail}"


if __name__ == "__main__":
    README.write_text(page(README.read_text(encoding="utf-8")), encoding="utf-8")
