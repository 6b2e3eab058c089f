"""Readers of the pedals' tracks: axes of an input device (evdev), channels of converters (IIO).

Both read the absolute state each time and no events: what the kernel drops from a queue of events
(SYN_DROPPED) cannot leave a pedal stuck.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from vcu_gateway.errors import ConfigError, Problem, UnavailableError, extra_needed
from vcu_gateway.pedals.configuration import PedalsConfig

BY_ID = Path("/dev/input/by-id")
IIO_DEVICES = Path("/sys/bus/iio/devices")
_MV_PER_V = 1000
_INSTALL = "sudo apt install python3-evdev, or pip install 'vcu-gateway[pedals]'"


class PedalSource(Protocol):
    """Device that has the value of each track."""

    name: str

    def read(self) -> Mapping[str, float]:
        """Values by track; OSError or ValueError where one cannot be read."""
        ...

    def close(self) -> None: ...


class EvdevSource:
    """Axes of an input device, each read with EVIOCGABS; OSError once the device has gone.

    The library keeps the interpreter waiting with it: a read that hangs stops the whole process,
    and the demand's time to live ends it.
    """

    def __init__(self, path: Path, axes: Mapping[str, str]) -> None:
        with extra_needed("a joystick needs", "pedals", "evdev", remedy=_INSTALL):
            import evdev
        self.name = str(path)
        self._device = evdev.InputDevice(str(path))
        there = self._device.capabilities(absinfo=False).get(evdev.ecodes.EV_ABS, [])
        self._codes = {track: evdev.ecodes.ecodes.get(axis) for track, axis in axes.items()}
        missing = [axes[track] for track, code in self._codes.items() if code not in there]
        if missing:
            self.close()
            known = [
                name
                for name, code in evdev.ecodes.ecodes.items()
                if name[:4] == "ABS_" and code in there
            ]
            what = f"{self.name} has no axis {', '.join(missing)}"
            raise ConfigError(Problem(what, "", f"it has {', '.join(sorted(known))}"))

    def read(self) -> dict[str, float]:
        return {track: self._device.absinfo(code).value for track, code in self._codes.items()}

    def close(self) -> None:
        self._device.close()


class IioSource:
    """Channels of converters in volts: (raw + offset) * scale, as sysfs has them."""

    def __init__(self, channels: Mapping[str, str], folder: Path = IIO_DEVICES) -> None:
        self.name = ", ".join(sorted({channel.partition("/")[0] for channel in channels.values()}))
        self._channels = channels
        self._files: dict[str, tuple[int, float, float]] = {}
        try:
            for track, channel in channels.items():
                path = folder / channel
                offset, scale = _of_channel(path, "offset", 0.0), _of_channel(path, "scale", None)
                raw = os.open(f"{path}_raw", os.O_RDONLY | os.O_CLOEXEC)
                self._files[track] = raw, offset, scale
        except BaseException:
            self.close()
            raise

    def read(self) -> dict[str, float]:
        return {track: self._read(track) for track in self._files}

    def _read(self, track: str) -> float:
        raw, offset, scale = self._files[track]
        try:
            return (int(os.pread(raw, 32, 0)) + offset) * scale / _MV_PER_V
        except (OSError, ValueError) as error:
            raise OSError(f"{self._channels[track]}: {error}") from error

    def close(self) -> None:
        for raw, _, _ in self._files.values():
            os.close(raw)
        self._files = {}


def _of_channel(path: Path, name: str, default: float | None) -> float:
    """A number of the channel itself, or else of all of its kind."""
    kind = re.sub(r"\d+", "", path.name)
    for file in (Path(f"{path}_{name}"), path.with_name(f"{kind}_{name}")):
        if file.exists():
            return float(file.read_text())
    if default is None:
        raise FileNotFoundError(f"{path}_{name} is not there")
    return default


def open_source(config: PedalsConfig, iio_devices: Path = IIO_DEVICES) -> PedalSource:
    """The configured source, opened; UnavailableError where it is not there."""
    iio = config.device.iio
    try:
        if iio is not None:
            return IioSource(iio.tracks(), iio_devices)
        axes = {track: travel.axis or "" for track, travel in config.tracks().items()}
        return EvdevSource(BY_ID / (config.device.evdev or ""), axes)
    except (OSError, ValueError) as error:
        where = f"ls {BY_ID}" if iio is None else f"grep . {iio_devices}/*/name"
        remedy = f"`{where}` shows what is there; this user must be allowed to read it"
        what = f"the pedals cannot be opened: {error}"
        raise UnavailableError(Problem(what, "", remedy)) from error
