"""The page's server on drive modes and curves: what it shows, and who may ask for a mode."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.driven import wait_until
from tests.web.conftest import PASSWORD
from tests.web.stand import Answer, GatewayProcess, WebProcess, gateway_running, serving

EXAMPLES = Path(__file__).parents[2] / "config" / "examples"
CONFIG = """
curves: {power_limit_w: {by_motor_temperature_c: [[95, 14000], [110, 6000]]}}
drive_modes: {start: eco, modes: {eco: {power_limit_w: 8000}, valet: {left_by_service: true}}}
"""


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GatewayProcess]:
    with gateway_running(tmp_path_factory.mktemp("tuned"), CONFIG) as one:
        yield one


@pytest.fixture(scope="module")
def pedals(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GatewayProcess]:
    example = yaml.safe_load((EXAMPLES / "pedals.yaml").read_text())
    example["protocol"] = {"dbc": str(EXAMPLES / "pedals.dbc")}
    with gateway_running(tmp_path_factory.mktemp("pedals"), yaml.safe_dump(example)) as one:
        yield one


def ask(web: WebProcess, body: object) -> Answer:
    return web.request("POST", "/api/drive-mode", json.dumps(body).encode())


def mode(web: WebProcess) -> str:
    found: str = web.request("GET", "/api/tuning").json["drive_mode"]["current"]
    return found


def test_the_page_has_the_drive_mode_and_where_the_vehicle_is_on_each_curve(tmp_path, tuned):
    with serving(tmp_path, tuned.socket_path) as web:
        found = web.request("GET", "/api/tuning").json
    assert found["drive_mode"]["modes"] == ["eco", "valet"]
    (curve,) = found["curves"]
    assert (curve["key"], curve["limits"]) == (
        "curves.power_limit_w.by_motor_temperature_c",
        False,
    )
    assert curve["x"] > 0


def test_the_page_has_the_pedals_on_can_and_of_bad_frames_no_number(tmp_path, pedals):
    with serving(tmp_path, pedals.socket_path) as web:
        found = web.request("GET", "/api/tuning").json["pedals"]
    assert found["throttle_pct"] is found["brake_pct"] is None
    assert found["sentence"] == "checksum wrong; no frame that is a demand"


def test_an_operator_asks_for_a_mode_and_the_service_level_leaves_a_locked_one(
    tmp_path: Path, tuned: GatewayProcess, users_file: Path
):
    with serving(tmp_path, tuned.socket_path, "--users", str(users_file)) as web:
        assert ask(web, {"mode": "valet"}).status == 401
        web.sign_in("anna", PASSWORD)
        assert ask(web, {"mode": "valet"}).status == 403
        web.sign_in("otto", PASSWORD)
        assert ask(web, {"mode": "valet"}).status == 200
        wait_until(lambda: mode(web) == "valet", "valet")
        refused = ask(web, {"mode": "eco"})
        assert refused.status == 409
        assert refused.json["sentence"] == "drive mode valet is left at service level"
        assert ask(web, {"mode": "eco", "level": "service"}).status == 403
        told = [one["action"] for one in web.events("action_asked")]
    with serving(tmp_path, tuned.socket_path, "--local-role", "service") as web:
        assert ask(web, {"mode": "eco", "level": "service"}).status == 200
        wait_until(lambda: mode(web) == "eco", "eco")
    assert "drive mode valet" in told


@pytest.mark.parametrize("body", [{}, {"mode": 5}, {"mode": "eco", "level": "root"}, []])
def test_a_wrong_request_for_a_mode_is_told(tmp_path, tuned, body):
    with serving(tmp_path, tuned.socket_path, "--local-role", "service") as web:
        assert ask(web, body).status == 400


def test_without_a_gateway_there_is_no_tuning(tmp_path):
    with serving(tmp_path, tmp_path / "nobody.sock") as web:
        assert web.request("GET", "/api/tuning").status == 503
