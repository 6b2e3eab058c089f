"""Interface diagnostics: the problem with an interface, and its remedy, as sentences."""

import errno
from collections.abc import Callable

from vcu_gateway.bus.interface import Interface, can_socket_error
from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.errors import Problem

_USUAL_BIT_S = 250_000
_WITHOUT_CAN = "this kernel has no CAN; try `vcu-gateway demo`, or a kernel with the can modules"


def unopened(error: Exception, settings: BusSettings) -> Problem:
    code, channel = getattr(error, "errno", None), settings.channel
    if settings.interface == "udp_multicast" and "msgpack" in str(error):
        remedy = "install the extra: pip install 'vcu-gateway[multicast]'"
    elif settings.interface != "socketcan":
        remedy = "check bus.interface and bus.channel"
    elif code == errno.EAFNOSUPPORT:
        remedy = _WITHOUT_CAN
    elif code == errno.ENODEV:
        remedy = _how_to_make(settings)
    else:
        remedy = f"look at: ip -details link show {channel}"
    return Problem(f"cannot open {settings.interface} {channel}: {error}", remedy=remedy)


def unfit(found: Interface | None, settings: BusSettings, renamed_to: str | None) -> Problem | None:
    """Problem that keeps an interface from being opened; None where it can be.

    `renamed_to` is what the one that was open before is called now, None where it is gone.
    """
    channel = settings.channel
    if found is None and renamed_to is not None:
        remedy = f"rename it back, or set bus.channel to {renamed_to}"
        return Problem(f"{channel} was renamed to {renamed_to}", remedy=remedy)
    if found is None:
        what = f"cannot open socketcan {channel}: no such interface"
        return Problem(what, remedy=_how_to_make(settings) if _kernel_has_can() else _WITHOUT_CAN)
    if not found.is_can:
        what = f"cannot open socketcan {channel}: it is no CAN interface"
        return Problem(what, remedy="bus.channel must be one of: ip -brief link show type can")
    if not found.up:
        return Problem(f"{channel} is down", remedy=f"ip link set {channel} up")
    return None


def left(
    opened: Interface,
    found: Interface | None,
    channel: str,
    name_of: Callable[[int], str | None],
) -> str | None:
    """Problem of an interface in use that cannot be used any more; None where it can.

    `name_of` returns the present name of an interface.
    """
    if found is None or found.number != opened.number:
        name = name_of(opened.number)
        return f"{channel} is gone" if name is None else f"{channel} was renamed to {name}"
    return None if found.up else f"{channel} is down"


def _kernel_has_can() -> bool:
    error = can_socket_error()
    return error is None or error.errno not in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT)


def _how_to_make(settings: BusSettings) -> str:
    channel = settings.channel
    bit_rate = f"bitrate {settings.bit_rate_bit_s or _USUAL_BIT_S}"
    return (
        f"for a bench: ip link add dev {channel} type vcan && ip link set {channel} up; "
        f"for an adapter: plug it in and ip link set {channel} up type can {bit_rate}"
    )
