"""Freshness: deadlines of a message, from its period unless configured (docs/safety.md, Causes)."""

from collections.abc import Mapping
from dataclasses import dataclass

from vcu_gateway.core.spec import MessageSpec
from vcu_gateway.units import NS_PER_MS

_NEVER_NS = 2**62

# From this period on (ms): stale after so many periods, in tenths.
_STALE_TENTHS = ((500, 32), (100, 30), (50, 40), (0, 100))
_LATE_TENTHS = 22


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Ages, from the arrival stamp, beyond which a message is late or stale."""

    late_after_ns: int
    stale_after_ns: int


def deadlines(
    message: MessageSpec,
    late_after_ms: Mapping[str, int],
    stale_after_ms: Mapping[str, int],
) -> Deadlines:
    """The deadlines of a message; an override by name wins over what the period gives.

    A message without a period is never late or stale.
    """
    if message.period_ms is None:
        late_ns = stale_ns = _NEVER_NS
    else:
        stale_ns = message.period_ms * _stale_tenths(message.period_ms) * NS_PER_MS // 10
        late_ns = min(message.period_ms * _LATE_TENTHS * NS_PER_MS // 10, stale_ns)
    if message.name in stale_after_ms:
        stale_ns = stale_after_ms[message.name] * NS_PER_MS
    if message.name in late_after_ms:
        late_ns = late_after_ms[message.name] * NS_PER_MS
    return Deadlines(min(late_ns, stale_ns), stale_ns)


def _stale_tenths(period_ms: int) -> int:
    return next(tenths for least_ms, tenths in _STALE_TENTHS if period_ms >= least_ms)
