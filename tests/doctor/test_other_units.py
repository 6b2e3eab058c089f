"""Units of the exporter and the page: running, switched off, or down."""

import pytest

from tests.doctor.judged import not_ok, only
from tests.doctor.test_service import TOLD
from vcu_gateway.doctor.check_result import CheckResult, CheckStatus
from vcu_gateway.doctor.service import EXPORTER, WEB, OtherUnit, ServiceFacts, judge_other

BOTH = pytest.mark.parametrize("unit", [EXPORTER, WEB], ids=lambda unit: unit.name)


def judged(unit: OtherUnit, **changed: str) -> list[CheckResult]:
    return list(judge_other(unit, ServiceFacts(unit.name, {**TOLD, **changed})))


@BOTH
def test_one_that_runs_is_well(unit):
    (found,) = judged(unit)
    assert not_ok([found]) == {}
    assert found.what == f"{unit.name}: running as 700"


@BOTH
def test_one_that_is_switched_off_is_no_fault(unit):
    (found,) = judged(unit, UnitFileState="disabled", ActiveState="inactive")
    assert not_ok([found]) == {}


@BOTH
@pytest.mark.parametrize(
    ("changed", "remedy"),
    [
        ({"ActiveState": "inactive"}, "sudo systemctl start"),
        ({"ActiveState": "failed", "ExecMainStatus": "69"}, "journalctl -u"),
        ({"ActiveState": "activating", "SubState": "auto-restart"}, "journalctl -u"),
    ],
)
def test_one_that_should_run_and_does_not_is_a_warning(unit, changed, remedy):
    found = only(judged(unit, **changed))
    assert (found.kind, unit.name in found.what) == (CheckStatus.WARNING, True)
    assert unit.lost in found.what
    assert found.remedy.startswith(remedy)


@pytest.mark.parametrize("properties", [None, {"LoadState": "not-found"}])
def test_nothing_is_said_where_it_is_not_installed(properties):
    assert list(judge_other(WEB, ServiceFacts(WEB.name, properties))) == []
