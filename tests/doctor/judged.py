"""What an examination said, in the shape that tests compare."""

from collections.abc import Iterable

from vcu_gateway.doctor.check_result import Finding, Kind


def complaints(findings: Iterable[Finding]) -> dict[str, str]:
    """Kind by check, of all that is not well."""
    return {one.check: one.kind.value for one in findings if one.kind is not Kind.OK}


def only(findings: Iterable[Finding]) -> Finding:
    """The one thing that is not well."""
    (one,) = (one for one in findings if one.kind is not Kind.OK)
    return one


def well(findings: Iterable[Finding]) -> str:
    """The lines of what is well."""
    return "\n".join(one.what for one in findings if one.kind is Kind.OK)
