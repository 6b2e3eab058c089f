"""docs/monitoring/README.md: the table is the code's, and what it names is there."""

import re

import click

from tests.monitoring.paths import MONITORING, README
from tests.monitoring.table import page
from vcu_gateway import cli, exporter

TEXT = README.read_text(encoding="utf-8")


def test_the_table_of_metrics_is_current():
    assert page(TEXT) == TEXT, "python -m tests.monitoring.table"


def test_every_metric_that_the_page_names_exists():
    known = {family.name for family in exporter.FAMILIES}
    assert set(re.findall(r"\b(?:vcu_gateway|process)_\w+", TEXT)) == known


def test_the_files_that_it_links_to_are_there():
    for link in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        assert (MONITORING / link).exists(), link


def test_no_example_gives_the_exporter_the_port_of_the_page():
    units = {
        name: (MONITORING.parents[1] / "systemd" / f"vcu-gateway-{name}.service").read_text(
            encoding="utf-8"
        )
        for name in ("exporter", "web")
    }
    ports = {name: set(re.findall(r"SocketBindAllow=tcp:(\d+)", units[name])) for name in units}
    further = set(re.findall(r"SocketBindAllow=tcp:(\d+)", TEXT))
    assert further
    assert not (further | ports["exporter"]) & ports["web"]
    assert not further & ports["exporter"]
    for text in (TEXT, *units.values()):
        listening = set(re.findall(r"ExecStart=.*--listen \S+:(\d+)", text))
        assert listening == set(re.findall(r"SocketBindAllow=tcp:(\d+)", text))


def test_the_verbs_that_it_names_exist():
    verbs = re.findall(r"`vcu-gateway ([a-z-]+)", TEXT)
    assert set(verbs) <= set(cli.group.list_commands(click.Context(cli.group)))
