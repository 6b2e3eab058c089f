#!/usr/bin/env python3
"""Drive with a joystick: Linux's joystick interface, no library.

Stick forward is throttle, back is brake. Buttons: 0 arms, 1 disarms, 2 changes the direction
(stick released), 3 cuts the power. Where the joystick vanishes, or this program hangs or ends,
no motion is asked for. A wireless joystick that dies without a word looks like one that is held
still: use a wire.
"""

import argparse
import logging
import os
import select
import struct
import sys
import time
from collections.abc import Iterator

from vcu_gateway.client import Client, ClientError, DemandOwner, RefusedError

PERIOD_S = 0.02
ARM, DISARM, REVERSE, STOP = range(4)

EVENT = struct.Struct("=IhBB")  # time in ms, value, type, number: linux/joystick.h
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
FULL_DEFLECTION = 32767

log = logging.getLogger("joystick")


class JoystickGoneError(Exception):
    """The device ended."""


class Joystick:
    """The device, its axes as they are now and its buttons as they are pressed."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        self._axes: dict[int, int] = {}

    def position(self, axis: int) -> float:
        """-1 to 1; 0 before it was first moved."""
        return max(-1.0, self._axes.get(axis, 0) / FULL_DEFLECTION)

    def pressed_until(self, end_s: float) -> Iterator[int]:
        """The buttons that are pressed until then; JoystickGoneError where the device ends."""
        left_s = 1.0
        while left_s > 0:
            left_s = max(0.0, end_s - time.monotonic())
            if select.select([self._file], [], [], left_s)[0]:
                yield from self._read()

    def _read(self) -> Iterator[int]:
        try:
            data = os.read(self._file, EVENT.size * 64)
        except OSError as error:
            raise JoystickGoneError(str(error)) from error
        if not data:
            raise JoystickGoneError("the device ended")
        for _, value, kind, number in EVENT.iter_unpack(data):
            if kind & ~INITIAL == AXIS:
                self._axes[number] = value
            elif kind == BUTTON and value:  # An initial state is no press.
                yield number


def deflection(position: float, dead_band: float) -> float:
    """-1 to 1: nothing inside the dead band, then from 0 on without a step."""
    beyond = max(0.0, abs(position) - dead_band) / (1 - dead_band)
    return beyond if position > 0 else -beyond


class Driver:
    """Turns the stick and the buttons into requests."""

    def __init__(self, client: Client, owner: DemandOwner, args: argparse.Namespace) -> None:
        self._client = client
        self._owner = owner
        self._most_pct = args.max_throttle_pct
        self._dead_band = args.dead_band
        self._forward = 0.0
        self._reverse = False

    def press(self, button: int) -> None:
        """What a button asks for."""
        if button == REVERSE and self._forward == 0:
            self._reverse = not self._reverse
            log.info("direction: %s", "reverse" if self._reverse else "forward")
        asked = {ARM: self._client.arm, DISARM: self._client.disarm, STOP: self._client.estop}
        if button in asked:
            try:
                log.info("%s: %s", asked[button].__name__, asked[button]()["mode"])
            except RefusedError as refusal:
                log.warning("refused: %s", refusal)

    def move(self, position: float) -> None:
        """Ask for what the stick says; forward is negative, as Linux has it."""
        self._forward = -deflection(position, self._dead_band)
        try:
            self._owner.set(
                throttle_pct=self._most_pct * max(0.0, self._forward),
                brake_pct=100 * max(0.0, -self._forward),
                motor_reverse=self._reverse,
            )
        except RefusedError as refusal:
            log.warning("refused: %s", refusal)


def run(client: Client, joystick: Joystick, args: argparse.Namespace) -> None:
    """Drive until the joystick vanishes."""
    with client.demand("joystick") as owner:
        log.info("ready; button %d arms", ARM)
        driver = Driver(client, owner, args)
        deadline_s = time.monotonic()
        while True:
            deadline_s = max(deadline_s + PERIOD_S, time.monotonic())
            for button in joystick.pressed_until(deadline_s):
                driver.press(button)
            driver.move(joystick.position(args.axis))


def main() -> int:
    """Parse the command line and drive; 0 interrupted, 1 with a reason on stderr."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--socket", help="the gateway's socket; default: as the client finds it")
    parser.add_argument("--device", default="/dev/input/js0", help="default: %(default)s")
    parser.add_argument("--axis", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--dead-band", type=float, default=0.1, help="default: %(default)s")
    parser.add_argument("--max-throttle-pct", type=float, default=30, help="default: %(default)s")
    args = parser.parse_args()
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    try:
        with Client(args.socket) as client:
            run(client, Joystick(args.device), args)
    except KeyboardInterrupt:
        log.info("interrupted")
        return 0
    except JoystickGoneError as error:
        log.error("the joystick is gone (%s); no motion is asked for", error)
    except (ClientError, OSError) as error:
        log.error("%s", error)
    return 1


if __name__ == "__main__":
    sys.exit(main())
