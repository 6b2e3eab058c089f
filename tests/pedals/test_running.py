"""Pedals beside a real gateway: 50 Hz, release and end, a second program, a gateway that goes."""

import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from tests.app.conftest import PATIENT
from tests.driven import Driven, armed, driven, wait_until
from tests.pedals.converters import CONVERTERS, Converters
from vcu_gateway.client import Client, RefusedError
from vcu_gateway.errors import GatewayError, RequestRefusedError, UnavailableError
from vcu_gateway.pedals import configuration, program
from vcu_gateway.pedals.sources import IioSource, PedalSource

# They are armed once, which a gateway without a processor refuses; and the rate is judged.
pytestmark = pytest.mark.clock

PRIORITY = "demand: {priorities: {remote: 10}}\n"


class SlowSource:
    """PedalSource whose reads take as long as a test says."""

    def __init__(self, source: PedalSource) -> None:
        self.name, self.close, self._source = source.name, source.close, source
        self.takes_s: list[float] = []

    def read(self) -> Mapping[str, float]:
        if self.takes_s:
            time.sleep(self.takes_s.pop(0))
        return self._source.read()


class Pedals:
    """The program in a thread, on converters of its own.

    Attributes:
        raised: what ended it; None while it runs, or where it was stopped.
    """

    def __init__(self, folder: Path, gateway: Driven) -> None:
        self.converters = Converters(folder)
        file = folder / "pedals.yaml"
        file.write_text(CONVERTERS)
        self.config = configuration.load(file)
        assert self.config.device.iio is not None
        tracks = self.config.device.iio.tracks()
        self.source = SlowSource(IioSource(tracks, self.converters.folder))
        self.said: list[str] = []
        self.raised: GatewayError | None = None
        self._socket_path = gateway.socket_path
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            with Client(self._socket_path) as client:
                program.run(self.config, self.source, client, self._stop, self.said.append)
        except GatewayError as error:
            self.raised = error

    def start(self) -> None:
        self._thread.start()

    def until_demanding(self) -> None:
        wait_until(lambda: bool(self.said) or self.ended, "the demand")

    @property
    def ended(self) -> bool:
        return not self._thread.is_alive()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()
        self.source.close()


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    with driven(tmp_path_factory.mktemp("gateway"), always=PATIENT + PRIORITY) as one:
        one.until_ready()
        yield one


@pytest.fixture
def pedals(gateway: Driven, tmp_path: Path) -> Iterator[Pedals]:
    one = Pedals(tmp_path, gateway)
    yield one
    one.stop()


@pytest.fixture
def driving(gateway: Driven, pedals: Pedals) -> Iterator[Pedals]:
    """Half of the travel is pressed, and throttle is on the bus."""
    gateway.until_ready()
    pedals.start()
    pedals.until_demanding()
    drive(gateway, pedals)
    yield pedals
    pedals.stop()
    gateway.until_mode("standby")


def drive(gateway: Driven, pedals: Pedals) -> None:
    with gateway.client() as operator:
        gateway.until(lambda: armed(operator), "arm")
    pedals.converters.press(50)
    gateway.throttles()
    gateway.until(lambda: any(gateway.throttles()), "throttle")


def assert_released(gateway: Driven, pedals: Pedals, why: str) -> None:
    """It has ended by itself for this reason, and the vehicle has no throttle."""
    wait_until(lambda: pedals.ended, "the end")
    assert isinstance(pedals.raised, UnavailableError)
    assert why in str(pedals.raised)
    assert pedals.raised.exit_code == 69
    gateway.until_mode("standby")
    gateway.throttles()
    gateway.until(lambda: gateway.throttles() == {0}, "commands without throttle")


def test_what_the_pedals_say_is_demanded_50_times_a_second(gateway, driving):
    with gateway.client() as client:
        before, begun_s = client.health()["api"]["requests"], time.monotonic()
        time.sleep(2)  # what is counted: 100 demands
        after, ended_s = client.health()["api"]["requests"], time.monotonic()
    assert (after - before) / (ended_s - begun_s) == pytest.approx(50, abs=2.5)


def test_both_tracks_and_the_brake_reach_the_gateway_as_demanded(gateway, driving):
    driving.converters.write("iio:device0/in_voltage1", "900")
    with gateway.client() as client:
        demanded = {
            "throttle_pct": pytest.approx(50, abs=0.1),
            "brake_pct": pytest.approx(7.4, abs=0.1),
        }
        gateway.until(lambda: client.state()["demanded"]["PCU1"] == demanded, "the brake")
        assert client.why()["demand"]["source"] == "pedals"


@pytest.mark.parametrize("broken", ["", "nonsense"])
def test_a_converter_that_cannot_be_read_ends_the_drive(gateway, driving, broken):
    driving.converters.write("iio:device0/in_voltage0", broken)
    assert_released(gateway, driving, "cannot be read: iio:device0/in_voltage0: ")


def test_a_wire_that_is_open_ends_the_drive(gateway, driving):
    driving.converters.write("iio:device1/in_voltage0", "0")
    assert_released(gateway, driving, "beyond its travel: throttle_track2 at -19 %")


def test_two_late_reads_in_a_row_end_the_drive(gateway, driving):
    driving.source.takes_s = [0.06, 0.06]
    assert_released(gateway, driving, "reads are late, the last one by ")


def test_while_a_read_hangs_no_throttle_is_demanded(gateway, driving):
    driving.source.takes_s = [1.0]
    with gateway.client() as client:
        gateway.until(
            lambda: client.state()["demanded"]["PCU1"]["throttle_pct"] == 0, "no throttle"
        )
        assert not driving.ended
        assert client.why()["demand"]["fresh"], "the client has taken it back by itself"
    assert_released(gateway, driving, "reads are late, the last one by ")


def test_stopped_it_releases_and_has_failed_in_nothing(gateway, driving):
    driving.stop()
    assert driving.raised is None
    gateway.until_mode("standby")


def test_another_program_that_demands_is_told_that_the_pedals_own_the_demand(gateway, driving):
    with (
        gateway.client() as client,
        pytest.raises(RefusedError, match="pedals owns the demand"),
        client.demand("driver"),
    ):
        pass
    gateway.until(lambda: any(gateway.throttles()), "throttle all the same")
    assert not driving.ended


def test_pedals_beside_an_owner_of_the_demand_are_refused_and_say_what_to_do(gateway, pedals):
    with gateway.client() as client, client.demand("driver"):
        pedals.start()
        wait_until(lambda: pedals.ended, "the end")
    assert isinstance(pedals.raised, RequestRefusedError)
    assert str(pedals.raised) == (
        "refused: driver owns the demand; another program demands: end it, or see demand.priorities"
    )
    assert pedals.raised.exit_code == 75
    assert pedals.said == []


def test_a_source_of_higher_priority_takes_over_and_the_pedals_end(gateway, driving):
    with gateway.client() as client, client.demand("remote"):
        wait_until(lambda: driving.ended, "the end")
    assert isinstance(driving.raised, RequestRefusedError)
    assert "refused: remote owns the demand" in str(driving.raised)


@pytest.mark.ci
def test_a_gateway_that_goes_is_waited_for_and_the_next_one_begins_unarmed(tmp_path):
    with driven(tmp_path, always=PATIENT) as first:
        first.until_ready()
        pedals = Pedals(tmp_path, first)
        pedals.start()
        pedals.until_demanding()
        drive(first, pedals)
    try:
        wait_until(lambda: pedals.said[1:] == ["the gateway has gone; waiting for it"], "the word")
        with driven(tmp_path, always=PATIENT) as second:
            second.until_mode("standby")
            wait_until(lambda: pedals.said[2:] == ["demanding again"], "the word")
            second.throttles()
            with second.client() as client, pytest.raises(RefusedError):
                client.arm()  # the pedal is pressed
            assert second.throttles() <= {0}
            pedals.converters.press(0)
            drive(second, pedals)
            pedals.stop()
    finally:
        pedals.stop()
    assert pedals.raised is None
