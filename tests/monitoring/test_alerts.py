"""docs/monitoring/vcu-gateway-alerts.yaml: rules over what exists, with words that help."""

import re

import click
import pytest
import yaml

from tests.monitoring.known import complaints
from tests.monitoring.paths import ALERTS, MONITORING
from vcu_gateway import cli
from vcu_gateway.config import Config

RULES = [
    rule
    for group in yaml.safe_load(ALERTS.read_text(encoding="utf-8"))["groups"]
    for rule in group["rules"]
]
EVERY_RULE = pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])


@EVERY_RULE
def test_a_rule_names_only_metrics_labels_and_values_that_exist(rule):
    words = "\n".join(rule["annotations"].values())
    assert complaints(rule["expr"], words) == []


@EVERY_RULE
def test_a_rule_has_a_severity_a_summary_and_says_what_to_do(rule):
    assert rule["labels"]["severity"] in ("critical", "warning")
    assert set(rule["annotations"]) == {"summary", "description"}
    assert "$labels.instance" in rule["annotations"]["summary"]
    assert len(rule["annotations"]["summary"]) <= 120
    assert len(rule["annotations"]["description"].split()) >= 20


@EVERY_RULE
def test_a_rule_names_only_verbs_and_keys_that_exist(rule):
    words = rule["annotations"]["description"]
    for verb in re.findall(r"`vcu-gateway ([a-z-]+)", words):
        assert verb in cli.group.list_commands(click.Context(cli.group)), verb
    for section, key in re.findall(r"\b(api|bus|safety)\.(\w+)", words):
        model = Config.model_fields[section].annotation
        assert key in model.model_fields, f"{section}.{key}"


def test_the_names_of_the_rules_are_unique():
    names = [rule["alert"] for rule in RULES]
    assert len(names) == len(set(names))
    assert all(name.startswith("VcuGateway") for name in names)


def test_the_example_scrapes_the_job_that_the_rules_name():
    example = yaml.safe_load((MONITORING / "prometheus.yml").read_text(encoding="utf-8"))
    (job,) = example["scrape_configs"]
    down = next(rule for rule in RULES if rule["alert"] == "VcuGatewayExporterDown")
    assert f'job="{job["job_name"]}"' in down["expr"]
    assert example["rule_files"] == [ALERTS.name]
