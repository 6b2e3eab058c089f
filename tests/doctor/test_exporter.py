"""The exporter's unit: running, switched off, or down."""

import pytest

from tests.doctor.judged import not_ok, only
from tests.doctor.test_service import TOLD
from vcu_gateway.doctor.check_result import CheckStatus
from vcu_gateway.doctor.exporter import UNIT, judge
from vcu_gateway.doctor.service import ServiceFacts


def of(**changed: str) -> ServiceFacts:
    return ServiceFacts(UNIT, {**TOLD, **changed})


def test_a_running_exporter_is_well():
    (found,) = judge(of())
    assert not_ok([found]) == {}
    assert found.what == "vcu-gateway-exporter.service: running as 700"


def test_one_that_is_switched_off_is_no_fault():
    (found,) = judge(of(UnitFileState="disabled", ActiveState="inactive"))
    assert not_ok([found]) == {}


@pytest.mark.parametrize(
    ("changed", "remedy"),
    [
        ({"ActiveState": "inactive"}, "sudo systemctl start"),
        ({"ActiveState": "failed", "ExecMainStatus": "69"}, "journalctl -u"),
        ({"ActiveState": "activating", "SubState": "auto-restart"}, "journalctl -u"),
    ],
)
def test_an_exporter_that_should_run_and_does_not_is_a_warning(changed, remedy):
    found = only(judge(of(**changed)))
    assert (found.kind, UNIT in found.what) == (CheckStatus.WARNING, True)
    assert found.remedy.startswith(remedy)


@pytest.mark.parametrize("properties", [None, {"LoadState": "not-found"}])
def test_nothing_is_said_where_it_is_not_installed(properties):
    assert list(judge(ServiceFacts(UNIT, properties))) == []
