"""The tap: every call that may change the core is noted, and nothing else is different."""

import inspect

import pytest

from tests.core.simulated_drive import CODEC, Drive
from tests.drive.tapped import TappedDrive
from vcu_gateway.core import inputs
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.operator_requests import OperatorRequests
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.drive.tap import Tap, TappedGateway, TappedRequests

READING = {
    Gateway: {"snapshot", "safe_frames", "why", "reasons", "stop"},
    # `refuse` emits an event, for the core alone: `reload` and its like call it.
    OperatorRequests: {"refuse", "against_arming", "against_resetting", "demanded"},
}


@pytest.mark.parametrize(
    ("kind", "tapped"), [(Gateway, TappedGateway), (OperatorRequests, TappedRequests)]
)
def test_every_method_that_changes_the_core_is_tapped(kind, tapped):
    """A new one belongs into core/inputs.py and drive/tap.py, or into the list above."""
    methods = {name for name, _ in inspect.getmembers(kind, inspect.isfunction) if name[0] != "_"}
    assert methods - READING[kind] == {name for name in vars(tapped) if name[0] != "_"} - {"tap"}


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
    frames, calls = drive.tap.take()
    assert len(frames) > 3
    assert [type(call.what) for call in calls] == [inputs.OfferInput, inputs.TickInput]
    assert drive.tap.take() == ([], [])


def test_a_tick_that_fails_is_noted_without_a_result():
    tap = Tap()
    gateway = TappedGateway(CODEC, Settings(), 0, tap)
    gateway.supervisor.mode = None
    with pytest.raises(ValueError, match="not in tuple"):
        gateway.tick(5)
    assert [(call.what, call.answer) for call in tap.calls] == [(inputs.TickInput(5), None)]
