"""Configuration of the pedals: device, travel of each track, rate. No device is opened here."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, Field, model_validator

from vcu_gateway.errors import ConfigError
from vcu_gateway.strict_yaml import file_text, parser, validation
from vcu_gateway.strict_yaml.file_text import FileProblem
from vcu_gateway.strict_yaml.validation import Section, refusal

_BENCH = "write `bench_use_only: true`, and use it on a bench alone"
_TRACKS_DIFFERENCE_PCT = 10.0  # what the gateway lets two tracks differ by


def _matching(pattern: str, requirement: str) -> AfterValidator:
    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise refusal(requirement)
        return text

    return AfterValidator(check)


_Axis = Annotated[str, _matching(r"ABS_[A-Z0-9_]+", "must be the name of an axis, such as ABS_Z")]
_Channel = Annotated[
    str,
    _matching(
        r"iio:device\d+/in_voltage\d+(-voltage\d+)?",
        "must be a channel, such as iio:device0/in_voltage0",
    ),
]
_ById = Annotated[str, _matching(r"[^/]+", "must be a name in /dev/input/by-id, without a slash")]
_Of = TypeVar("_Of")


def _there(throttle: _Of, track2: _Of | None, brake: _Of | None) -> dict[str, _Of]:
    named = {"throttle": throttle, "throttle_track2": track2, "brake": brake}
    return {name: one for name, one in named.items() if one is not None}


class Travel(Section):
    """One track's two ends, in the unit that --show draws."""

    axis: _Axis | None = Field(None, description="Axis of the evdev device, such as ABS_Z.")
    released: float = Field(description="Value of the released pedal.")
    pressed: float = Field(description="Value of the pedal pressed to its end.")

    @model_validator(mode="after")
    def _has_ends(self) -> "Travel":
        if self.released == self.pressed:
            raise refusal("must have another value pressed than released", complete=True)
        return self

    def travel_pct(self, value: float) -> float:
        """Travel in percent: below 0 or above 100 beyond its ends."""
        return 100 * (value - self.released) / (self.pressed - self.released)


class IioChannels(Section):
    """Channel of each track: iio:deviceN/in_voltageM."""

    throttle: _Channel = Field(description="Channel of the throttle.")
    throttle_track2: _Channel | None = Field(None, description="Channel of its second track.")
    brake: _Channel | None = Field(None, description="Channel of the brake.")

    def tracks(self) -> dict[str, str]:
        return _there(self.throttle, self.throttle_track2, self.brake)


class Device(Section):
    """Where the pedals are: one of the two."""

    evdev: _ById | None = Field(None, description="Name of the device in /dev/input/by-id.")
    iio: IioChannels | None = Field(None, description="Channels of the kernel's converters.")

    @model_validator(mode="after")
    def _is_one(self) -> "Device":
        if (self.evdev is None) == (self.iio is None):
            raise refusal("must have one of evdev and iio", complete=True)
        return self


class PedalsConfig(Section):
    """The file."""

    source: str = Field("pedals", min_length=1, max_length=64, description="Name of the demand.")
    device: Device = Field(description="Where the pedals are.")
    throttle: Travel = Field(description="Travel of the throttle.")
    throttle_track2: Travel | None = Field(None, description="Travel of its second track.")
    brake: Travel | None = Field(None, description="Travel of the brake.")
    rate_hz: int = Field(50, ge=20, le=100, description="Reads a second.")
    dead_zone_pct: float = Field(3.0, ge=0, le=10, description="Of travel, at either end.")
    power_mode: Literal["eco", "normal", "turbo"] = Field("eco", description="PowerMode demanded.")
    regen_brake: bool = Field(False, description="Whether the brake regenerates.")
    bench_use_only: bool = Field(False, description="One track, or two on one converter.")

    def unfit(self) -> Iterator[FileProblem]:
        """What is wrong between keys that are each right."""
        iio = self.device.iio
        yield from self._unfit_axes() if iio is None else self._unfit_channels(iio)

    def tracks(self) -> dict[str, Travel]:
        """Travel of each track that is configured, by name."""
        return _there(self.throttle, self.throttle_track2, self.brake)

    def _unfit_axes(self) -> Iterator[FileProblem]:
        if self.throttle_track2 is not None:
            what = "must not be there: an evdev device counts as one track"
            yield FileProblem(("throttle_track2",), what)
        for name, travel in self.tracks().items():
            if travel.axis is None:
                yield FileProblem((name, "axis"), "is missing", "an axis such as ABS_Z")
        if not self.bench_use_only:
            what = "must be true: an evdev device has one track"
            yield FileProblem(("bench_use_only",), what, _BENCH)

    def _unfit_channels(self, iio: IioChannels) -> Iterator[FileProblem]:
        for name, travel in self.tracks().items():
            if travel.axis is not None:
                yield FileProblem((name, "axis"), "is for evdev", "remove it")
        for name in sorted(iio.tracks().keys() ^ self.tracks().keys()):
            what = "must stand below device.iio and at the top, or in neither"
            yield FileProblem((name,), what)
        channels = list(iio.tracks().values())
        if len(set(channels)) < len(channels):
            yield FileProblem(("device", "iio"), "must have another channel for each track")
        elif not self.bench_use_only:
            yield from self._unfit_second_track(iio)

    def _unfit_second_track(self, iio: IioChannels) -> Iterator[FileProblem]:
        second, place = self.throttle_track2, ("throttle_track2",)
        if second is None or iio.throttle_track2 is None:
            yield FileProblem(place, "is missing: one track is for a bench", _BENCH)
            return
        if iio.throttle.partition("/")[0] == iio.throttle_track2.partition("/")[0]:
            what = "must be on another converter than throttle"
            yield FileProblem(("device", "iio", *place), what, _BENCH)
        if _look_alike(self.throttle, second):
            what = (
                "must have another gradient or offset than throttle;"
                " a short between them would look like two tracks that agree"
            )
            yield FileProblem(place, what)


def _look_alike(first: Travel, second: Travel) -> bool:
    """Whether both would agree wherever they have the same value."""
    ends = (first.released, 0.0), (first.pressed, 100.0)
    return all(abs(second.travel_pct(value) - at) <= _TRACKS_DIFFERENCE_PCT for value, at in ends)


def load(path: Path) -> PedalsConfig:
    """The file's configuration; ConfigError with every problem in it."""
    document = parser.read(file_text.read(path))
    config, findings = validation.validated_document(PedalsConfig, document)
    if config is not None:
        findings += config.unfit()
    if config is None or findings:
        raise ConfigError(*file_text.problems(findings, str(path), document.lines))
    return config
