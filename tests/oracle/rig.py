"""Rig: gateway, vehicle, recorder, and a driver's demand that is renewed."""

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.oracle import pedal_node, wire
from tests.oracle.api import Client, RefusedError
from tests.oracle.invariants import Invariants
from tests.oracle.machine import MachineSpeed
from tests.oracle.process import PATIENCE_S, Gateway
from tests.oracle.recorder import Frame, Recorder
from tests.oracle.vehicle import Vehicle

RENEW_S = 0.15
RELEASED_S = 0.25
MODES = ("eco", "normal", "turbo", "safety")

Condition = Callable[[], object]


class Rig:
    """Gateway, vehicle and recorder for one test after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.recorder = Recorder()
        self.vehicle = Vehicle()
        self.rules = Invariants()
        self.started = 0
        self.left_out = self.repeated = self.unexplained = 0
        self.speed = MachineSpeed()
        self.gateway: Gateway | None = None
        self.client: Client | None = None
        self.source = "driver"
        self.pedals: dict | None = None
        self.renewed = self.released = 0.0
        self.rpm = (0, 0)

    # --- the process ---

    def run(self, sections: dict | None = None, *, fresh: bool = False) -> None:
        """A gateway with this configuration; the one that runs, where it has that already."""
        sections = sections or {}
        if (
            fresh
            or self.gateway is None
            or not self.gateway.runs
            or self.gateway.sections != sections
        ):
            self.begin(sections)
            self.connect()

    def begin(self, sections: dict) -> None:
        """A process of its own folder and configuration; its API is not waited for."""
        self.end()
        self.started += 1
        self.vehicle.pedals(fitted="pedals" in sections)
        self.gateway = Gateway(self.folder / f"g{self.started}", sections)
        self.rules = self._carried(Invariants(sections.get("limits")))
        self.launch()

    def launch(self) -> None:
        """Start the process (again), and expect nothing of the frames before."""
        self.pedals = None
        self.recorder.drain()
        self.rules.begin()
        self.gateway.start()

    def connect(self) -> None:
        self.hang_up()
        self.client = self.gateway.client()

    def hang_up(self) -> None:
        if self.client:
            self.client.close()
            self.client = None

    def _carried(self, rules: Invariants) -> Invariants:
        rules.violations, rules.left_out = self.rules.violations, self.rules.left_out
        rules.speeds = self.rules.speeds
        return rules

    def end(self) -> None:
        self.pedals = None
        self.hang_up()
        if self.gateway:
            self.gateway.end()
        self.pump()
        self.gateway = None

    def close(self) -> None:
        self.end()
        self.vehicle.close()

    # --- time passes ---

    def pump(self) -> None:
        """Read the bus, judge what came, and renew the demand."""
        for frame in self.recorder.drain():
            self.rules.take(frame)
        must_renew = self.pedals is not None and not self.has_node
        if must_renew and time.monotonic() - self.renewed > RENEW_S:
            with contextlib.suppress(RefusedError):
                self._renew()

    def wait(self, condition: Condition, what: str, patience_s: float = PATIENCE_S) -> Any:
        deadline = time.monotonic() + patience_s
        while True:
            self.pump()
            if found := condition():
                return found
            assert time.monotonic() < deadline, (
                f"waited {patience_s} s in vain for {what}: {self.command()}, {self._why()}"
            )
            time.sleep(0.008)

    def rest(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.pump()
            time.sleep(min(left, 0.02))
        self.pump()

    def until(self, t: float) -> None:
        self.rest(max(0.0, t - time.monotonic()))

    # --- the driver ---

    @property
    def has_node(self) -> bool:
        """Whether the demand comes from a pedal node, which repeats it by itself."""
        return self.gateway is not None and "pedals" in self.gateway.sections

    def press(self, **raws: int) -> None:
        """What the node sends from now on, by raw values; released where nothing is said."""
        sends: dict[str, Any] = {**pedal_node.RELEASED, **raws}
        coast = self.gateway.sections["pedals"]["can"].get("coast_brake_pct")
        sent = time.monotonic()
        self.vehicle.set(pedal_node.MESSAGE, **sends)
        self.rules.asked(sent, time.monotonic(), pedal_node.demanded(sends, coast))

    def _renew(self) -> None:
        if self.has_node:
            self.press(**pedal_node.codes(self.pedals))
            return
        sent = time.monotonic()
        self.client.demand(self.source, **self.pedals)
        self.renewed = sent
        self.rules.asked(sent, time.monotonic(), self.pedals)

    def demand(self, **values: Any) -> None:
        """Demand this, and renew it."""
        was_pressed = self.pedals is None or self.pedals.get("throttle_pct", 0)
        if was_pressed and not values.get("throttle_pct", 0):
            self.released = time.monotonic()
        self.pedals = values
        self._renew()

    def let_go(self) -> None:
        """Renew nothing more: the demand will expire."""
        self.pedals = None

    def release(self) -> None:
        """End the demand, where there is one."""
        self.pedals = None
        self.client.refusal("demand.release", source=self.source)

    def why(self) -> dict:
        return self.client.call("why")

    def _why(self) -> str:
        return self.why()["sentence"] if self.client else "no gateway"

    def mode(self) -> str:
        return self.why()["mode"]

    def speeds(self, rpm1: int, rpm2: int | None = None) -> None:
        """Turn the motors; they go on so in whatever follows."""
        self.rpm = (rpm1, rpm1 if rpm2 is None else rpm2)
        self.vehicle.speeds(*self.rpm)

    def standby(self) -> None:
        """All well, unarmed, the pedals released, the drive mode of the start; whatever was."""
        self.vehicle.heal()
        self.vehicle.speeds(*self.rpm)
        deadline = time.monotonic() + PATIENCE_S
        self.demand()
        if modes := self.gateway.sections.get("drive_modes"):
            self.client.call("drive_mode.set", mode=modes["start"], level="service")
        while True:
            self.pump()
            why = self.why()
            if why["mode"] == "active":
                self.client.refusal("disarm")
            elif why["mode"] == "fault":
                self.client.refusal("reset", level="service")
            elif why["mode"] == "standby" and not (why["blocks"] or why["limits"] or why["alarms"]):
                break
            assert time.monotonic() < deadline, f"not well: {why}"
            time.sleep(0.08)

    def arm(self) -> None:
        """As soon as it is granted: a slow machine may cost a demand or two."""
        self.until(self.released + RELEASED_S)
        self.rules.armed()
        deadline = time.monotonic() + 1.0
        while refused := self.client.refusal("arm"):
            if time.monotonic() > deadline:
                raise refused
            self.rest(0.05)

    def service_reset(self) -> None:
        """As soon as it is granted."""
        self.demand()
        self.wait(
            lambda: self.client.refusal("reset", level="service") is None, "a service reset", 4.0
        )

    def drive(self, **values: Any) -> None:
        """From wherever it is to ACTIVE with the throttle where it was asked."""
        for left in (2, 1, 0):
            if self.mode() != "active" or self._must_rise(values):
                self.standby()
                self.arm()
            self.demand(**values)
            wanted = wire.percent(values.get("throttle_pct", 0))
            if self._reached(wanted):
                return
            assert left, f"throttle {wanted}: {self.command()}, {self._why()}"

    def _must_rise(self, values: dict) -> bool:
        """Whether PowerMode is lower than asked: with throttle it stays there."""
        last = self.command()
        asked = MODES.index(values.get("power_mode", "eco"))
        return last is not None and last.power_mode < asked

    def _reached(self, throttle: int) -> bool:
        """Whether it gets there; not where the drive ends, as on a machine that is too slow."""
        deadline = time.monotonic() + 4.0
        while time.monotonic() < deadline:
            self.rest(0.01)
            last = self.command()
            if last is not None and not self.is_safe(last) and last.throttle == throttle:
                return True
        return False

    @staticmethod
    def is_safe(command: wire.Command) -> bool:
        return command.power_mode == 3 and command.power_limit == 0

    def command(self) -> wire.Command | None:
        return self.recorder.commands[-1].command if self.recorder.commands else None

    def commands(self, since: float, until: float | None = None) -> list[Frame]:
        self.pump()
        frames = self.recorder.commands_since(since)
        return [f for f in frames if until is None or f.t <= until]
