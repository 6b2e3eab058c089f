"""Time of day of a recorded instant, in UTC, as the folders of drives have it."""

import datetime

from vcu_gateway.units import NS_PER_MS, NS_PER_S


class TimeOfDay:
    """Clock of a drive: wall time is monotonic time and `distance_ns`."""

    def __init__(self, distance_ns: int) -> None:
        self._distance_ns = distance_ns

    def wall_ns(self, now_ns: int) -> int:
        """Wall time of an instant of the gateway's clock."""
        return now_ns + self._distance_ns

    def clock(self, now_ns: int) -> str:
        """Time of day, as 12:03:14.150."""
        return self._date(now_ns).strftime("%H:%M:%S.") + self._milliseconds(now_ns)

    def iso(self, now_ns: int) -> str:
        """Date and time, as 2026-11-23T12:03:14.150Z."""
        return self._date(now_ns).strftime("%Y-%m-%dT%H:%M:%S.") + self._milliseconds(now_ns) + "Z"

    def _date(self, now_ns: int) -> datetime.datetime:
        seconds = self.wall_ns(now_ns) // NS_PER_S
        return datetime.datetime.fromtimestamp(seconds, datetime.UTC)

    def _milliseconds(self, now_ns: int) -> str:
        return f"{self.wall_ns(now_ns) % NS_PER_S // NS_PER_MS:03}"
