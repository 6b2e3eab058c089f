"""Check results in the shape that tests compare."""

from collections.abc import Iterable

from vcu_gateway.doctor.check_result import CheckResult, CheckStatus


def not_ok(findings: Iterable[CheckResult]) -> dict[str, str]:
    """Kind by check, of every result that is not ok."""
    return {one.check: one.kind.value for one in findings if one.kind is not CheckStatus.OK}


def only(findings: Iterable[CheckResult]) -> CheckResult:
    """The only result that is not ok."""
    (one,) = (one for one in findings if one.kind is not CheckStatus.OK)
    return one


def well(findings: Iterable[CheckResult]) -> str:
    """The texts of the results that are ok."""
    return "\n".join(one.what for one in findings if one.kind is CheckStatus.OK)
