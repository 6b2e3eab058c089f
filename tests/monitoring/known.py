"""What an expression may name, held against the metrics of a driven gateway."""

import functools
import re

from tests.monitoring.program import Scrape, driven
from tests.monitoring.promql import Selector, named

TARGET_LABELS = {"instance", "job"}
"""Prometheus adds these to every sample."""

_TEMPLATE = re.compile(r"\{\{\s*\$labels\.(\w+)|\{\{\s*(\w+)\s*\}\}")


@functools.cache
def driven_scrape() -> Scrape:
    return driven().scrape()


def complaints(expression: str, template: str = "") -> list[str]:
    """What an expression, or a text made of its labels, names that does not exist."""
    found, scrape = named(expression), driven_scrape()
    told = [fault for one in found.selectors for fault in _faults(one, scrape)]
    labels = set(TARGET_LABELS)
    for one in found.selectors:
        labels |= scrape.labels.get(one.name, set())
    told += [f"no metric has the label {label}" for label in found.grouping - labels]
    left = found.grouping or labels
    wanted = {one or other for one, other in _TEMPLATE.findall(template)}
    return told + [f"the text names {label}, the result has none" for label in wanted - left]


def _faults(one: Selector, scrape: Scrape) -> list[str]:
    if one.name == "up":  # Prometheus's own
        return []
    if one.name not in scrape.labels:
        return [f"there is no metric {one.name}"]
    samples = [dict(labels) for labels in scrape.of(one.name)]
    told = []
    for label, (operator, wanted) in one.labels.items():
        if label in TARGET_LABELS:
            continue
        values = [labels[label] for labels in samples if label in labels]
        if not values:
            told.append(f"{one.name} has no label {label}")
        elif operator == "=" and wanted not in values:
            told.append(f"{one.name} has no {label} {wanted!r}")
        elif operator == "=~":
            alternatives = wanted.split("|")
            told += [f"{one.name} has no {label} {a!r}" for a in alternatives if a not in values]
    return told
