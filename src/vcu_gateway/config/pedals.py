"""Section of the configuration for pedals on CAN (docs/safety.md, Pedals)."""

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import Field

from vcu_gateway.config.tuning import checked_points, curve_type, refused_point
from vcu_gateway.config.value_types import Confirmation
from vcu_gateway.core import can_pedals, pedal_frames
from vcu_gateway.core.can_pedals import CanPedals, PedalTrack
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.core.tuning import Quantity
from vcu_gateway.errors import did_you_mean
from vcu_gateway.strict_yaml.file_text import FileProblem, KeyPath
from vcu_gateway.strict_yaml.validation import Section
from vcu_gateway.units import NS_PER_MS

_CAN: KeyPath = ("pedals", "can")
_SHORTEST_MS, _LONGEST_MS = 10, 50
_TRACKS_DIFFERENCE_PCT = 10.0
_CHECKSUM_BITS = 8
_TRAVEL = Quantity("pedal_pct", "pedal", "%", 0, 5, 0.1)
_COAST = Quantity("brake_pct", "brake", "%", 0, 30)


class PedalTrackSection(Section):
    """A pedal's signal, and its value where it is released and pressed, in the signal's unit."""

    signal: str = Field(description="Name of the signal in the message.", examples=["Throttle1"])
    released: float = Field(description="Its value where nobody presses.", examples=[0.62])
    pressed: float = Field(
        description="Its value at the end of the travel; it may be the lower one.", examples=[3.85]
    )


class PedalChecksumSection(Section):
    """Checksum over all other bytes of the frame."""

    signal: str = Field(description="Name of the signal, one whole byte.", examples=["Checksum"])
    kind: can_pedals.ChecksumKind = Field(
        description="How it is made; sum is modulo 256, sae_j1850 its CRC-8.",
        examples=["sae_j1850"],
    )


def _coast_points(value: Any) -> Any:
    points = checked_points(value, _TRAVEL, _COAST, rises=False)
    if points[-1][1] != 0:
        what = "the last point must be at a brake of 0 %"
        raise refused_point(len(points) - 1, what, "a pedal that is pressed does not coast")
    return points


_COAST_TYPE, _COAST_FIELD = curve_type(
    _coast_points, _TRAVEL, _COAST, False, [[0, 15], [5, 0]],
    "Regeneration of a released pedal, as part of the demand: Brake over travel, x 0 to 5 %, y 0 to"
    " 30 %, must not rise, ends at 0. Measure what a per cent brakes first. Without it none.",
)  # fmt: skip


class CanPedalsSection(Section):
    """Message of the vehicle's own DBC that carries the pedals; it comes every 10 to 50 ms."""

    message: str = Field(
        description="Name of the message, sent to VCU.", examples=["Pedals_Position"]
    )
    counter: str | None = Field(
        default=None,
        description="Signal that counts the frames, by 1 in its range; without it a node that"
        " repeats its last frame is believed.",
        examples=["Counter"],
    )
    reverse: str | None = Field(
        default=None,
        description="Signal that is 1 for reverse and 0 for forwards; without it always forwards.",
        examples=["ReverseSwitch"],
    )
    power_mode: Literal["eco", "normal", "turbo"] = Field(
        default="eco", description="Power mode of the demand; a drive mode caps it."
    )
    regen_brake: bool = Field(default=False, description="Demand RegenBrake with every frame.")
    dead_zone_pct: float = Field(
        default=3.0,
        ge=0,
        le=10,
        description="Travel at either end that asks for 0 and for 100 %.",
    )
    # A type that is made from a table, as those of config/tuning.py.
    coast_brake_pct: _COAST_TYPE = _COAST_FIELD  # type: ignore[valid-type]
    single_track_bench_use_only: Confirmation | None = Field(
        default=None,
        description="Only where throttle_track2 is missing: true confirms that this is a test bench"
        " and the wheels are off the ground.",
        json_schema_extra={"const": True},
        examples=[True],
    )
    throttle: PedalTrackSection = Field(description="First track of the throttle pedal.")
    throttle_track2: PedalTrackSection | None = Field(
        default=None,
        description="Second track, of another gradient or offset; throttle 0 where both differ by"
        " more than 10 % for more than 100 ms.",
        examples=[{"signal": "Throttle2", "released": 0.31, "pressed": 1.92}],
    )
    brake: PedalTrackSection | None = Field(
        default=None,
        description="Brake pedal, or its pressure; without it brake over throttle is not watched.",
        examples=[{"signal": "BrakePressure", "released": 0.5, "pressed": 60}],
    )
    checksum: PedalChecksumSection | None = Field(
        default=None, description="Checksum of the frame; without it none is checked."
    )


class PedalsSection(Section):
    """Pedals that the gateway reads itself; any other one is a client of the API."""

    can: CanPedalsSection | None = Field(
        default=None,
        description="A pedal node on CAN, the source pedals of demands; protocol.dbc has its"
        " message.",
    )


def pedals_of(section: PedalsSection) -> CanPedals | None:
    """The core's pedals of a section."""
    if section.can is None:
        return None
    return can_pedals.of_values(section.can.model_dump(exclude={"single_track_bench_use_only"}))


def contradictions(section: PedalsSection, *, second_track_required: bool) -> Iterator[FileProblem]:
    """Problems of two keys together."""
    can = section.can
    if can is None:
        return
    for name, track in _tracks(can).items():
        if track.pressed == track.released:
            what = f"must differ from released, {track.released:g}"
            yield FileProblem((*_CAN, name, "pressed"), what, "measure both ends of the travel")
    if can.throttle_track2 is None:
        if can.single_track_bench_use_only is None:
            remedy = "one track is for a bench alone: single_track_bench_use_only: true"
            yield FileProblem((*_CAN, "throttle_track2"), "is missing", remedy)
        if second_track_required:
            what = "is true, and pedals.can has one track"
            yield FileProblem(("demand", "second_track_required"), what, "add throttle_track2")
    yield from _used_twice(can)


def _used_twice(can: CanPedalsSection) -> Iterator[FileProblem]:
    owners: dict[str, str] = {}
    for path, signal in _signals(can):
        owner = ".".join(map(str, path[len(_CAN) :])).removesuffix(".signal")
        if signal in owners:
            what = f"{signal} is {owners[signal]} already"
            yield FileProblem(path, what, "each needs a signal of its own")
        owners.setdefault(signal, owner)


def _tracks(can: CanPedalsSection) -> Mapping[str, PedalTrackSection]:
    tracks = {"throttle": can.throttle, "throttle_track2": can.throttle_track2, "brake": can.brake}
    return {name: track for name, track in tracks.items() if track is not None}


def _signals(can: CanPedalsSection) -> Iterator[tuple[KeyPath, str]]:
    """Place and name of every signal."""
    for name, track in _tracks(can).items():
        yield (*_CAN, name, "signal"), track.signal
    if can.counter is not None:
        yield (*_CAN, "counter"), can.counter
    if can.checksum is not None:
        yield (*_CAN, "checksum", "signal"), can.checksum.signal
    if can.reverse is not None:
        yield (*_CAN, "reverse"), can.reverse


def check_message(
    section: PedalsSection, protocol: ProtocolSpec, *, ttl_max_ms: int
) -> Iterator[FileProblem]:
    """Problems of message and signals with the protocol, and with a demand's time to live."""
    can = section.can
    if can is None:
        return
    messages = {message.name: message for message in protocol.received_by(OWN_NODE)}
    message = messages.get(can.message)
    if message is None:
        names = list(messages)
        remedy = did_you_mean(can.message, names) or f"its messages are {', '.join(names)}"
        what = f'the gateway receives no message "{can.message}"'
        yield FileProblem((*_CAN, "message"), what, remedy)
        return
    yield from _period(message, ttl_max_ms)
    missing = list(_missing(can, message))
    signals = {signal.name: signal for signal in message.signals}
    yield from missing or [*_ends(can, signals), *_codes(can, signals), *_alike(can, signals)]


def _period(message: MessageSpec, ttl_max_ms: int) -> Iterator[FileProblem]:
    period_ms = message.period_ms
    if period_ms is None or not _SHORTEST_MS <= period_ms <= _LONGEST_MS:
        given = "has no period" if period_ms is None else f"comes every {period_ms} ms"
        remedy = f"a message of pedals comes every {_SHORTEST_MS} to {_LONGEST_MS} ms"
        yield FileProblem((*_CAN, "message"), f"{message.name} {given}", remedy)
        return
    needed_ms = pedal_frames.expiry_ms(period_ms) + Settings().period_ns // NS_PER_MS
    if ttl_max_ms < needed_ms:
        what = f"must be at least {needed_ms} ms, not {ttl_max_ms}"
        remedy = f"a demand of {message.name} counts so long"
        yield FileProblem(("demand", "ttl_max_ms"), what, remedy)


def _missing(can: CanPedalsSection, message: MessageSpec) -> Iterator[FileProblem]:
    names = list(message.signal_names)
    for path, signal in _signals(can):
        if signal not in names:
            remedy = did_you_mean(signal, names) or f"its signals are {', '.join(names)}"
            yield FileProblem(path, f'{message.name} has no signal "{signal}"', remedy)


_Signals = Mapping[str, SignalSpec]


def _ends(can: CanPedalsSection, signals: _Signals) -> Iterator[FileProblem]:
    for name, track in _tracks(can).items():
        signal = signals[track.signal]
        for end in ("released", "pressed"):
            value = getattr(track, end)
            if not signal.minimum <= value <= signal.maximum:
                span = f"{signal.minimum:g} to {signal.maximum:g} {signal.unit}".rstrip()
                what = f"must be {span}, as the signal, not {value:g}"
                yield FileProblem((*_CAN, name, end), what)


def _codes(can: CanPedalsSection, signals: _Signals) -> Iterator[FileProblem]:
    for key in ("counter", "reverse"):
        name = getattr(can, key)
        if name is not None and not _is_code(signals[name]):
            yield FileProblem((*_CAN, key), f"{name} must be unsigned, with factor 1 and offset 0")
    checksum = can.checksum and signals[can.checksum.signal]
    if checksum and not (_is_code(checksum) and _is_byte(checksum)):
        what = f"{checksum.name} must be one whole byte, with factor 1 and offset 0"
        yield FileProblem((*_CAN, "checksum", "signal"), what)


def _alike(can: CanPedalsSection, signals: _Signals) -> Iterator[FileProblem]:
    second = can.throttle_track2
    if second is not None and _look_alike(can.throttle, second):
        units = [signals[one.signal].unit for one in (can.throttle, second)]
        if units[0] == units[1] != "%":
            what = "must have another gradient or offset than throttle"
            remedy = "a short between them would look like two tracks that agree"
            yield FileProblem((*_CAN, "throttle_track2"), what, remedy)


def _is_code(signal: SignalSpec) -> bool:
    return not signal.signed and (signal.factor, signal.offset) == (1, 0)


def _is_byte(signal: SignalSpec) -> bool:
    first = min(signal.bit_positions())
    return signal.length_bits == _CHECKSUM_BITS and first % 8 == 0


def _look_alike(first: PedalTrackSection, second: PedalTrackSection) -> bool:
    """Whether both would agree wherever they carry the same value."""
    other, ends = PedalTrack(**second.model_dump()), ((first.released, 0), (first.pressed, 100))
    return all(abs(other.travel_pct(value) - at) <= _TRACKS_DIFFERENCE_PCT for value, at in ends)


def hints(section: PedalsSection) -> Iterator[FileProblem]:
    """What these pedals cannot watch; it prevents no start."""
    can = section.can
    if can is None:
        return
    if can.brake is None:
        yield FileProblem(_CAN, "has no brake: brake over throttle is not watched")
    if can.counter is None:
        yield FileProblem(_CAN, "has no counter: a node that repeats its last frame is believed")
    second = can.throttle_track2
    if second is None:
        yield FileProblem(_CAN, "has one track: on a test bench alone")
    elif _look_alike(can.throttle, second):
        what = "has the ends of throttle: only the node can see a short between them"
        yield FileProblem((*_CAN, "throttle_track2"), what)
