"""The tap: every call that may change the core is noted, and nothing else is different."""

import inspect
import re
from pathlib import Path
from typing import Any

import pytest

from tests.core.simulated_drive import CODEC, Drive
from tests.recording.tapped import TappedDrive
from vcu_gateway import daemon
from vcu_gateway.core import calls
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.operator_requests import OperatorRequests
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.recording.tap import Tap, TappedGateway

READING: dict[type, set[str]] = {
    # `fit_laws` belongs to `reload`, and to a core that is restored.
    Gateway: {"apply", "snapshot", "safe_frames", "why", "reasons", "stop", "fit_laws"},
    # `refuse` emits an event, for the core alone: `reload` and its like call it.
    # `take_pedal_frames` is the tick's own: a replay makes the same demands of the same frames.
    OperatorRequests: {
        *("refuse", "against_arming", "against_resetting", "demanded", "take_pedal_frames"),
    },
}


CLASSES: list[Any] = [*calls.WORDS, calls.Receive]
MADE = {name for kind in CLASSES for name in kind.apply.__code__.co_names}
SHELL = Path(daemon.__file__).parents[1]


@pytest.mark.parametrize("kind", READING)
def test_every_method_that_changes_the_core_is_a_call(kind):
    """A new one belongs into core/calls.py, or into the list above."""
    methods = {name for name, _ in inspect.getmembers(kind, inspect.isfunction) if name[0] != "_"}
    assert methods - READING[kind] <= MADE


@pytest.mark.parametrize("package", ["app.py", "daemon", "server", "demo"])
def test_the_shell_makes_every_call_where_the_tap_notes_it(package):
    changing = [MADE & set(vars(kind)) - {"receive", "tick"} for kind in READING]
    direct = re.compile(rf"(gateway|requests)\.({'|'.join(changing[0] | changing[1])})\(")
    folder = SHELL / package
    for path in [folder] if folder.is_file() else folder.rglob("*.py"):
        assert not direct.search(path.read_text()), path


def test_a_tapped_core_does_what_a_plain_one_does():
    results = []
    for drive in (Drive(), TappedDrive()):
        drive.until(Mode.STANDBY).run(1500)
        drive.arm()
        drive.demanded = ControllerDemand(throttle_pct=30)
        results.append([drive.tick()[1:] for _ in range(40)])
    assert results[0] == results[1]


def test_what_was_taken_is_not_there_any_more():
    drive = TappedDrive()
    drive.tick()
    frames, noted = drive.tap.take()
    assert len(frames) > 3
    assert [type(call.what) for call in noted] == [calls.Offer, calls.RunTick]
    assert drive.tap.take() == ([], [])


def test_a_tick_that_fails_is_noted_without_a_result():
    tap = Tap()
    gateway = TappedGateway(CODEC, Settings(), 0, tap)
    gateway.supervisor.mode = None
    with pytest.raises(ValueError, match="not in tuple"):
        gateway.tick(5)
    assert [(call.what, call.answer) for call in tap.calls] == [(calls.RunTick(5), None)]


def test_a_call_that_fails_is_noted_without_an_answer():
    tap = Tap()
    gateway = TappedGateway(CODEC, Settings(), 0, tap)
    gateway.requests = None
    with pytest.raises(AttributeError):
        gateway.apply(calls.Arm(5))
    assert [(call.what, call.answer) for call in tap.calls] == [(calls.Arm(5), None)]


def test_frames_and_ticks_are_noted_once_however_they_are_given():
    drive = TappedDrive()
    drive.gateway.apply(calls.Receive(Frame(1, bytes(8), drive.now_ns)))
    drive.gateway.apply(calls.RunTick(drive.now_ns))
    frames, noted = drive.tap.take()
    assert (len(frames), len(noted)) == (1, 1)
