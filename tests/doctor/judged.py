"""What an examination said, in the shape that tests compare."""

from collections.abc import Iterable

from vcu_gateway.doctor.check_result import CheckResult, CheckStatus


def complaints(findings: Iterable[CheckResult]) -> dict[str, str]:
    """Kind by check, of all that is not well."""
    return {one.check: one.kind.value for one in findings if one.kind is not CheckStatus.OK}


def only(findings: Iterable[CheckResult]) -> CheckResult:
    """The one thing that is not well."""
    (one,) = (one for one in findings if one.kind is not CheckStatus.OK)
    return one


def well(findings: Iterable[CheckResult]) -> str:
    """The lines of what is well."""
    return "\n".join(one.what for one in findings if one.kind is CheckStatus.OK)
