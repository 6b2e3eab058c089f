"""Which golden drives hold which fault of tests/faults/catalogue.toml, and why some hold none."""

from tests.golden.every import DRIVES

CANNOT: dict[int, str] = {
    5: "The kernel hands no CAN FD frame to a classic socket, so that the core is given none.",
    9: "Refused when the file is read: no gateway runs.",
    21: "Refused by the configuration and the API: the core is given none.",
    55: "The core has no wall clock; a step of it is in the recording's clock lines.",
    60: "Refused when the file is read: no gateway runs.",
    61: "Refused when the file is read: the core is given no settings.",
    63: "Refused when the file is read: no gateway runs, or it keeps what it has.",
    64: "No input of the core: what is lost is the log, or the recording itself (tests/vcan).",
    65: "No input of the core: the log waits beside it.",
    66: "No input of the core: connections that are refused ask for nothing.",
    68: "Refused by the API: what is no request reaches no core.",
    69: "Refused by the API: what is not permitted reaches no core.",
    83: "No input of the core: it knows neither language nor time zone.",
}
"""Faults that no recording can hold: a recording has what the core was given."""


def holding(number: int) -> list[str]:
    """Names of the drives that hold this fault."""
    return [name for name, drive in DRIVES.items() if number in drive.faults]
