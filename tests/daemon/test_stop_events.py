"""Events of a stop: one for each change, and a warning where it does not get on."""

from tests.core.simulated_drive import Drive, active
from vcu_gateway.daemon.events import EventLog, StopEvents

OBEYING = {f"PCU{n}_Status1.PowerCut": 1 for n in (1, 2)}


class Stopped:
    """A drive with an emergency stop, and the events of each tick since."""

    def __init__(self, drive: Drive | None = None) -> None:
        self.drive = drive or active()
        self.log = EventLog()
        self.heard: list[tuple[str, str]] = []
        self.log.subscribe(self._hear)
        self._events = StopEvents(self.log)
        self.drive.gateway.requests.emergency_stop()

    def _hear(self, event) -> None:
        assert event.name == "stop_stage"
        stop = self.drive.gateway.stop(self.drive.now_ns)
        assert event.fields == {"stage": stop.stage.value, "sentence": stop.sentence()}
        self.heard.append((event.fields["stage"], event.severity.name))

    def run(self, duration_ms: int) -> list[tuple[str, str]]:
        """Events of this time."""
        self.heard.clear()
        for _ in range(duration_ms // 50):
            self.drive.tick()
            self._events.after_tick(self.drive.gateway.stop(self.drive.now_ns), self.drive.now_ns)
        return list(self.heard)


def test_a_stop_that_is_obeyed_tells_each_stage_once():
    one = Stopped()
    one.drive.codes |= OBEYING
    assert one.run(5000) == [("sent", "INFO"), ("on the bus", "INFO"), ("cut", "INFO")]


def test_a_stop_that_is_not_obeyed_is_critical():
    assert Stopped().run(5000)[-1] == ("not obeyed", "CRITICAL")


def test_a_stop_that_is_not_sent_is_a_warning_where_it_lasts():
    one = Stopped()
    one.drive.accepted = False
    assert one.run(150 + 50) == [("latched", "INFO")]
    assert one.run(5000) == [("latched", "WARNING")]


def test_a_stop_that_does_not_come_back_is_a_warning_where_it_lasts():
    one = Stopped()
    one.drive.echo = False
    assert one.run(150 + 50) == [("sent", "INFO")]
    assert one.run(5000) == [("sent", "WARNING")]


def test_a_stop_that_comes_back_no_more_is_a_warning_at_once():
    one = Stopped()
    one.drive.codes |= OBEYING
    one.run(2000)
    one.drive.echo = False
    assert one.run(5000) == [("sent", "WARNING")]


def test_a_controller_that_does_not_confirm_is_a_warning():
    one = Stopped()
    one.drive.codes |= OBEYING
    one.drive.silent = {"PCU1_Status1"}
    assert one.run(1600) == [("sent", "INFO"), ("on the bus", "INFO")]
    assert one.run(5000) == [("on the bus", "WARNING")]


def test_a_stop_that_is_latched_anew_is_told_anew():
    one = Stopped()
    one.drive.codes |= OBEYING
    one.run(3000)
    assert one.drive.reset().granted
    assert one.run(500) == []
    one.drive.gateway.requests.emergency_stop()
    assert one.run(50) == [("sent", "INFO")]


def test_both_severities_of_a_stage_are_kept():
    one = Stopped()
    one.drive.echo = False
    one.run(1000)
    kept = [(entry.event.severity.name, entry.count) for entry in one.log.latest(10)]
    assert kept == [("INFO", 1), ("WARNING", 1)]
