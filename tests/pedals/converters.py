"""Two converters in the layout of /sys/bus/iio/devices, with a foot on the pedals."""

from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "config/examples"
CONVERTERS = (EXAMPLES / "converters.yaml").read_text()
RELEASED_MV = {"iio:device0/in_voltage0": 620, "iio:device1/in_voltage0": 310}
PRESSED_MV = {"iio:device0/in_voltage0": 3850, "iio:device1/in_voltage0": 1920}
BRAKE = "iio:device0/in_voltage1"


class Converters:
    """Files as the kernel shows them; a value is a raw number of millivolts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "devices"
        for name in ("iio:device0", "iio:device1"):
            (self.folder / name).mkdir(parents=True)
            (self.folder / name / "in_voltage_scale").write_text("1.0\n")
        self.write(BRAKE, "500")
        self.press(0)

    def press(self, pct: float) -> None:
        """Both tracks of the throttle at this travel."""
        for channel, released in RELEASED_MV.items():
            raw = released + (PRESSED_MV[channel] - released) * pct / 100
            self.write(channel, f"{raw:.0f}")

    def write(self, channel: str, raw: str, name: str = "raw") -> None:
        # In place: a reader keeps the file open. Blanks, so that it never reads half a number.
        path = self.folder / f"{channel}_{name}"
        with path.open("r+" if path.exists() else "w") as file:
            file.write(f"{raw:<15}\n")
