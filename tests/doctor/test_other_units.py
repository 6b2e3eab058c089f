"""Units of the exporter and the page: running, switched off, or down."""

import pytest

from tests.doctor.judged import not_ok, only
from tests.doctor.test_service import TOLD
from vcu_gateway.doctor.check_result import CheckResult, CheckStatus
from vcu_gateway.doctor.service import OTHERS, ServiceFacts, judge_other

BOTH = pytest.mark.parametrize("program", OTHERS)


def judged(program: str, **changed: str) -> list[CheckResult]:
    unit = f"vcu-gateway-{program}.service"
    return list(judge_other(program, ServiceFacts(unit, {**TOLD, **changed})))


@BOTH
def test_one_that_runs_is_well(program):
    (found,) = judged(program)
    assert not_ok([found]) == {}
    assert found.what == f"vcu-gateway-{program}.service: running as 700"


@BOTH
def test_one_that_is_switched_off_is_no_fault(program):
    (found,) = judged(program, UnitFileState="disabled", ActiveState="inactive")
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
def test_one_that_should_run_and_does_not_is_a_warning(program, changed, remedy):
    found = only(judged(program, **changed))
    assert (found.subject, found.kind) == (program, CheckStatus.WARNING)
    assert f"vcu-gateway-{program}.service " in found.what
    assert OTHERS[program] in found.what
    assert found.remedy.startswith(remedy)


@pytest.mark.parametrize("properties", [None, {"LoadState": "not-found"}])
def test_nothing_is_said_where_it_is_not_installed(properties):
    assert list(judge_other("web", ServiceFacts("vcu-gateway-web.service", properties))) == []
