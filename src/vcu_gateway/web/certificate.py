"""When a certificate ends; the standard library reads that of a peer alone, never its own."""

import asyncio
import re
import ssl
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

_ENDS_SOON = timedelta(days=30)
_LOOK_EVERY_S = 3600.0
_PEM = re.compile("-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL | re.ASCII)
_CONTEXT_0, _UTC_TIME = 0xA0, 0x17
_BEFORE_VALIDITY = 3  # serial number, signature, issuer


def end_of(chain: Path) -> datetime:
    """When the first certificate of this PEM file's chain ends; ValueError where none is there."""
    pems = _PEM.findall(chain.read_text())
    try:
        return min(_not_after(ssl.PEM_cert_to_DER_cert(pem)) for pem in pems)
    except (LookupError, ValueError, RuntimeError, StopIteration) as error:
        raise ValueError(f"{chain} has no certificate that can be read") from error


async def watch(end: datetime, tell: Callable[[str], None]) -> None:
    """Tell a person of the end while it is near, until cancelled."""
    told: str | None = None
    while True:
        sentence = ending_sentence(end, datetime.now(UTC))
        if sentence is not None and sentence != told:
            told = sentence
            tell(sentence)
        await asyncio.sleep(_LOOK_EVERY_S)


def ending_sentence(end: datetime, now: datetime) -> str | None:
    """What a person is to know of a certificate near its end; None before that."""
    left = end - now
    if left > _ENDS_SOON:
        return None
    when = f"{end:%Y-%m-%d %H:%M} UTC"
    if left <= timedelta(0):
        return f"The certificate ended on {when}: replace it."
    return f"The certificate ends on {when}: replace it."


def _not_after(der: bytes) -> datetime:
    """Field notAfter of X.509 (RFC 5280, 4.1): the second time of validity."""
    certificate = next(_values(der))[1]
    fields = list(_values(next(_values(certificate))[1]))
    if fields[0][0] == _CONTEXT_0:  # the version, which may be left out
        fields = fields[1:]
    _, (kind, text) = _values(fields[_BEFORE_VALIDITY][1])
    return _time(text.decode("ascii"), is_short=kind == _UTC_TIME)


def _time(text: str, *, is_short: bool) -> datetime:
    """UTCTime has two digits of the year, 50 to 99 those of the last century."""
    if is_short:
        text = ("19" if text >= "50" else "20") + text
    return datetime.strptime(text, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)


def _values(der: bytes) -> Iterator[tuple[int, bytes]]:
    """Tag and content of each value in these bytes; ValueError where they are no DER."""
    at = 0
    while at < len(der):
        tag, length, at = der[at], der[at + 1], at + 2
        if length & 0x80:
            size = length & 0x7F
            length, at = int.from_bytes(der[at : at + size], "big"), at + size
        if at + length > len(der):
            raise ValueError("no DER")
        yield tag, der[at : at + length]
        at += length
