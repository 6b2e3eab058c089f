"""Interface warnings: faults of the set-up of an interface that can be used all the same."""

from collections.abc import Iterator

from vcu_gateway.bus.reconnect import LinkOpened
from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.core.events import Event, Severity

_TX_QUEUE_AT_MOST = 4


def interface_warnings(opened: LinkOpened, settings: BusSettings) -> Iterator[Event]:
    """Warnings about an interface that was opened, each with the command that fixes it."""
    yield from _queue(opened, settings.channel)
    yield from _buffer(opened, settings.receive_buffer_bytes)
    yield from _bit_rate(opened, settings)
    yield from _echo(opened)


def _queue(opened: LinkOpened, channel: str) -> Iterator[Event]:
    """Frames that wait there are stale when they leave."""
    frames, is_used = opened.interface.tx_queue_frames, opened.details.queue_is_used
    if frames > _TX_QUEUE_AT_MOST and is_used is not False:
        command = f"ip link set {channel} txqueuelen {_TX_QUEUE_AT_MOST}"
        yield _warning("tx_queue_long", command, frames=frames)


def _buffer(opened: LinkOpened, wanted_bytes: int | None) -> Iterator[Event]:
    given = opened.receive_buffer_bytes
    if wanted_bytes is not None and given is not None and given < wanted_bytes:
        command = f"sysctl -w net.core.rmem_max={wanted_bytes}"
        yield _warning("receive_buffer_small", command, asked_bytes=wanted_bytes, given_bytes=given)


def _bit_rate(opened: LinkOpened, settings: BusSettings) -> Iterator[Event]:
    found, wanted = opened.details.bit_rate_bit_s, settings.bit_rate_bit_s
    if None not in (found, wanted) and found != wanted:
        link = f"ip link set {settings.channel}"  # only one that is down takes a bit rate
        command = f"{link} down && {link} up type can bitrate {wanted}"
        yield _warning("bit_rate_differs", command, wanted_bit_s=wanted, found_bit_s=found)


def _echo(opened: LinkOpened) -> Iterator[Event]:
    """A controller whose driver does not send our frames back: the kernel does, unasked."""
    if opened.details.state is not None and opened.details.driver_echoes is False:
        reason = "the driver confirms nothing: only the controllers' answers tell that frames left"
        yield Event("echo_unproven", Severity.WARNING, {"reason": reason})


def _warning(name: str, command: str, **fields: object) -> Event:
    return Event(name, Severity.WARNING, {**fields, "command": command})
