"""The table of all metrics in docs/monitoring/README.md.

`python -m tests.monitoring.table` writes it again.
"""

import json

from tests.monitoring.paths import DASHBOARD, README
from tests.monitoring.promql import named
from vcu_gateway.exporter import FAMILIES

BEGIN = "<!-- metrics: python -m tests.monitoring.table -->\n"
END = "<!-- end of metrics -->\n"


def shown() -> set[str]:
    """Families in a panel of the dashboard."""
    panels = json.loads(DASHBOARD.read_text(encoding="utf-8"))["panels"]
    targets = [target for panel in panels for target in panel.get("targets", ())]
    return {
        selector.name.removesuffix("_bucket")
        for target in targets
        for selector in named(target["expr"]).selectors
    }


def table() -> str:
    """A row for each family."""
    rows = ["| metric | labels | type | meaning | panel |", "| --- | --- | --- | --- | --- |"]
    in_a_panel = shown()
    for family in FAMILIES:
        labels = ", ".join(f"`{label}`" for label in family.labels)
        panel = "yes" if family.name in in_a_panel else "no"
        rows.append(f"| `{family.name}` | {labels} | {family.kind} | {family.help} | {panel} |")
    return "\n".join(rows) + "\n"


def page(before: str) -> str:
    """The page with the table as it is now."""
    head, _, rest = before.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{table()}\n{END}{tail}"


if __name__ == "__main__":
    README.write_text(page(README.read_text(encoding="utf-8")), encoding="utf-8")
