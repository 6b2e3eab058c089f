"""docs/monitoring/vcu-gateway-dashboard.json: panels over what exists."""

import itertools
import json

import pytest

from tests.monitoring.known import complaints
from tests.monitoring.paths import DASHBOARD
from tests.monitoring.promql import named

BOARD = json.loads(DASHBOARD.read_text(encoding="utf-8"))
PANELS = [panel for panel in BOARD["panels"] if panel["type"] != "row"]
EVERY_PANEL = pytest.mark.parametrize("panel", PANELS, ids=lambda panel: panel["title"])


@EVERY_PANEL
def test_a_panel_names_only_metrics_labels_and_values_that_exist(panel):
    for target in panel["targets"]:
        assert complaints(target["expr"], target["legendFormat"]) == [], target["expr"]


@EVERY_PANEL
def test_a_panel_shows_the_chosen_gateway_of_the_chosen_data_source(panel):
    assert panel["datasource"]["uid"] == "${datasource}"
    for target in panel["targets"]:
        assert target["datasource"]["uid"] == "${datasource}"
        for selector in named(target["expr"]).selectors:
            assert selector.labels["instance"] == ("=", "$instance")


def test_panels_do_not_overlap_and_have_numbers_of_their_own():
    ids = [panel["id"] for panel in BOARD["panels"]]
    assert len(ids) == len(set(ids))
    taken = [
        {
            (x, y)
            for x in range(grid["x"], grid["x"] + grid["w"])
            for y in range(grid["y"], grid["y"] + grid["h"])
        }
        for grid in (panel["gridPos"] for panel in BOARD["panels"])
    ]
    assert all(x < 24 for cells in taken for x, _ in cells)
    assert all(not one & other for one, other in itertools.combinations(taken, 2))


def test_the_rows_are_vehicle_bus_ticks_api_and_recorder():
    rows = [panel["title"] for panel in BOARD["panels"] if panel["type"] == "row"]
    assert rows == ["Vehicle", "Bus", "Ticks", "API", "Recorder"]


def test_throttle_and_motor_speed_are_in_one_panel():
    (panel,) = [panel for panel in PANELS if "motor speed" in panel["title"]]
    shown = {one.name for t in panel["targets"] for one in named(t["expr"]).selectors}
    assert {"vcu_gateway_command_throttle_ratio", "vcu_gateway_signal"} <= shown


def test_the_data_source_and_the_gateway_are_variables():
    variables = {one["name"]: one for one in BOARD["templating"]["list"]}
    assert variables["datasource"]["type"] == "datasource"
    assert variables["datasource"]["query"] == "prometheus"
    assert "label_values(vcu_gateway_build_info" in variables["instance"]["query"]["query"]
    assert BOARD["schemaVersion"] >= 39
