"""What is known of a stop: each row of docs/safety.md, healthy, at its limit and one beyond."""

from typing import Self

import pytest

from tests.core.simulated_drive import (
    CODEC,
    COMMAND_IDS,
    MS,
    POWER_CUT,
    PROTOCOL,
    ZERO_TORQUE,
    data,
)
from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.state import Store
from vcu_gateway.core.stop import ControllerStop, Stop, StopStage, StopWatch
from vcu_gateway.core.supervisor import FaultClass, LatchedFault

START_NS = 10_000 * MS
BOTH = ("PCU1", "PCU2")
BIT = dict.fromkeys(BOTH, (0, 0x80))
NEVER_STALE = {message.name: 2**62 for message in PROTOCOL.received_by("VCU")}


class Bench:
    """Frames, echoes and status at milliseconds after a latched CUT."""

    def __init__(self) -> None:
        self.watch = StopWatch(BIT)
        self.store = Store(PROTOCOL.received_by("VCU"), NEVER_STALE)
        self.latch: LatchedFault | None = LatchedFault(FaultClass.SERVICE, "estop", START_NS)
        self.echoes: dict[str, Frame] = {}
        self.follow()

    def follow(self) -> Self:
        """A tick takes in the latch and the last echoes."""
        self.watch.follow(self.latch, self.echoes)
        return self

    def send(self, at_ms: float, *names: str, payload: bytes = POWER_CUT) -> Self:
        for name in names or BOTH:
            self.watch.note_sent(name, payload, START_NS + int(at_ms * MS))
        return self

    def echo(self, at_ms: float, *names: str, payload: bytes = POWER_CUT) -> Self:
        for name in names or BOTH:
            at_ns = START_NS + int(at_ms * MS)
            self.echoes[name] = Frame(COMMAND_IDS[name], payload, at_ns, own_echo=True)
        return self.follow()

    def on_bus(self, at_ms: float, *names: str) -> Self:
        return self.send(at_ms, *names).echo(at_ms, *names)

    def until(self, at_ms: float, *names: str) -> Self:
        """POWER_CUT on the bus each 50 ms until then."""
        for sent_ms in range(0, int(at_ms) + 1, 50):
            self.on_bus(sent_ms, *names)
        return self

    def status(self, at_ms: float, *names: str, **raws: int) -> Self:
        for name in names or BOTH:
            message = f"{name}_Status1"
            decoded = CODEC.by_name[message].decode(data(message, {"PowerCut": 1} | raws))
            self.store.put(message, decoded, START_NS + int(at_ms * MS))
        return self

    def at(self, at_ms: float) -> Stop:
        now_ns = START_NS + int(at_ms * MS)
        stop = self.watch.judged(self.store.snapshot(now_ns), now_ns)
        assert stop is not None
        return stop


def since_ms(at_ns: int | None) -> float | None:
    return None if at_ns is None else (at_ns - START_NS) / MS


def cut() -> Bench:
    """A stop that both controllers have obeyed, at 500 ms."""
    return Bench().until(500).status(400)


def test_a_stop_that_both_obey_is_cut_with_every_time_of_it():
    stop = cut().at(500)
    assert stop.stage is StopStage.CUT
    assert stop.sentence() == "Power is cut: PCU1 and PCU2 confirm"
    assert (stop.latched_ns, stop.reason, stop.overdue) == (START_NS, "estop", ())
    one = ControllerStop(START_NS, START_NS, True, START_NS + 400 * MS, "cut", 0.0)
    assert stop.controllers == {"PCU1": one, "PCU2": one}
    assert [stop.missing(name) for name in BOTH] == ["", ""]


def test_without_a_latched_cut_nothing_is_known_nor_kept():
    bench = cut()
    bench.latch = None
    bench.follow().on_bus(550)
    now_ns = START_NS + 550 * MS
    assert bench.watch.judged(bench.store.snapshot(now_ns), now_ns) is None


def test_a_stop_that_is_latched_anew_begins_with_nothing():
    bench = cut()
    bench.latch = LatchedFault(FaultClass.SERVICE, "again", START_NS + 501 * MS)
    stop = bench.follow().at(501)
    assert (stop.stage, stop.reason) == (StopStage.LATCHED, "again")
    assert set(stop.controllers.values()) == {ControllerStop()}


def test_one_that_equals_the_latch_before_it_begins_with_nothing_too():
    bench = cut()
    bench.latch = LatchedFault(FaultClass.SERVICE, "estop", START_NS)
    assert bench.follow().at(500).controllers["PCU1"].sent_ns is None


# Sent, and on the bus.


@pytest.mark.parametrize(("age_ms", "holds"), [(0, True), (150, True), (150.000001, False)])
@pytest.mark.parametrize("name", BOTH)
def test_a_frame_counts_as_sent_for_150_ms(name, age_ms, holds):
    bench = Bench().until(1000).send(1000 + age_ms, *(set(BOTH) - {name}))
    stop = bench.at(1000 + age_ms)
    assert stop.controllers[name].sent_ns == (START_NS if holds else None)
    assert (stop.stage is StopStage.LATCHED) is not holds


@pytest.mark.parametrize(("age_ms", "holds"), [(0, True), (150, True), (150.000001, False)])
@pytest.mark.parametrize("name", BOTH)
def test_an_echo_counts_for_150_ms(name, age_ms, holds):
    other = set(BOTH) - {name}
    bench = Bench().until(1000).send(1000 + age_ms).echo(1000 + age_ms, *other)
    stop = bench.at(1000 + age_ms)
    assert stop.controllers[name].echoed_ns == (START_NS if holds else None)
    assert (stop.stage is StopStage.SENT) is not holds


@pytest.mark.parametrize(("gap_ms", "since"), [(150, 0), (151, 151)])
def test_a_gap_of_more_than_150_ms_counts_anew(gap_ms, since):
    one = Bench().on_bus(0).on_bus(gap_ms).on_bus(gap_ms + 50).at(gap_ms + 50).controllers["PCU1"]
    assert (since_ms(one.sent_ns), since_ms(one.echoed_ns)) == (since, since)


def test_frames_without_the_bit_count_as_nothing():
    bench = Bench().send(0, payload=ZERO_TORQUE)
    assert bench.at(0).stage is StopStage.LATCHED
    bench.send(0).echo(1, payload=ZERO_TORQUE)
    assert bench.at(1).stage is StopStage.SENT


def test_the_bit_alone_counts_whatever_else_the_frame_says():
    payload = bytes.fromhex("80ff000000000000")
    assert Bench().send(0, payload=payload).echo(0, payload=payload).at(1).stage is StopStage.ON_BUS


@pytest.mark.parametrize(("at_ms", "counts"), [(-0.000001, False), (0, True)])
def test_an_echo_of_before_the_latch_is_none_of_this_stop(at_ms, counts):
    bench = Bench().send(0).echo(at_ms)
    assert (bench.at(1).stage is StopStage.ON_BUS) is counts


def test_a_stop_that_is_sent_to_one_alone_is_only_latched():
    stop = Bench().on_bus(0, "PCU1").at(1)
    assert stop.stage is StopStage.LATCHED
    assert stop.sentence() == "Stop latched; not sent to PCU2"
    assert [stop.missing(name) for name in BOTH] == ["has not confirmed yet", "not sent"]
    assert Bench().at(1).sentence() == "Stop latched; not sent to PCU1 and PCU2"


def test_a_stop_that_came_back_from_one_alone_is_only_sent():
    stop = Bench().send(0).echo(0, "PCU1").at(1)
    assert stop.stage is StopStage.SENT
    assert stop.sentence() == "Stop sent; not seen on the bus for PCU2"
    assert [stop.missing(name) for name in BOTH] == ["has not confirmed yet", "not seen on the bus"]
    both = Bench().send(0).at(1)
    assert both.sentence() == "Stop sent; not seen on the bus for PCU1 and PCU2"


# Obeyed.


@pytest.mark.parametrize(("at_ms", "obeyed"), [(99.999999, None), (100, True)])
def test_a_status_counts_from_100_ms_after_the_first_echo(at_ms, obeyed):
    stop = Bench().on_bus(0).on_bus(50).status(at_ms).at(100)
    assert {one.obeyed for one in stop.controllers.values()} == {obeyed}
    assert stop.stage is (StopStage.CUT if obeyed else StopStage.ON_BUS)


def test_the_100_ms_count_from_the_echo_and_not_from_the_latch_or_the_sending():
    bench = Bench().send(0).send(50).on_bus(100).on_bus(150).status(199)
    assert bench.at(200).controllers["PCU1"].obeyed is None
    assert bench.status(200).at(200).controllers["PCU1"].obeyed is True


def test_after_a_gap_the_first_echo_of_the_stop_still_counts():
    stop = Bench().on_bus(0).on_bus(200).status(201).at(201)
    assert since_ms(stop.controllers["PCU1"].echoed_ns) == 200
    assert stop.stage is StopStage.CUT


@pytest.mark.parametrize(
    ("raws", "obeyed"),
    [
        ({}, True),
        ({"Throttle": 12}, True),
        ({"Throttle": 13}, False),
        ({"PowerCut": 0}, False),
        ({"PowerCut": 0, "Throttle": 51}, False),
    ],
)
@pytest.mark.parametrize("name", BOTH)
def test_a_controller_obeys_that_says_cut_and_a_throttle_below_5_percent(name, raws, obeyed):
    stop = cut().status(500, name, **raws).at(500)
    assert stop.controllers[name].obeyed is obeyed
    assert stop.stage is (StopStage.CUT if obeyed else StopStage.NOT_OBEYED)


def test_one_that_does_not_obey_is_named_with_what_it_reports():
    stop = cut().status(500, "PCU1", PowerCut=0, Throttle=51).at(500)
    says = "PCU1 reports PowerCut normal, throttle 19.9 %"
    assert stop.sentence() == f"NOT OBEYED: {says}; use the contactor"
    assert [stop.missing(name) for name in BOTH] == ["reports PowerCut normal, throttle 19.9 %", ""]
    both = cut().status(500, "PCU1", PowerCut=0, Throttle=51).status(500, "PCU2", Throttle=13)
    says += ", and PCU2 reports PowerCut cut, throttle 5.1 %"
    assert both.at(500).sentence() == f"NOT OBEYED: {says}; use the contactor"


def decoded_otherwise(bench: Bench, message: str, signal: str, raw: int, value: float) -> Decoded:
    """The latest frame with another code and value of a signal, though it could not carry them."""
    snapshot = bench.store.snapshot(START_NS)
    latest, index = snapshot.latest(message), snapshot.index(message, signal)
    assert latest is not None
    raws, values = list(latest.decoded.raws), list(latest.decoded.values)
    raws[index], values[index] = raw, value
    return Decoded((tuple(values), tuple(raws), 0))


def test_a_reserved_code_is_not_obeyed():
    bench = cut()
    decoded = decoded_otherwise(bench, "PCU2_Status1", "PowerCut", 2, 2)
    bench.store.put("PCU2_Status1", decoded, START_NS + 450 * MS)
    one = bench.at(500).controllers["PCU2"]
    assert (one.obeyed, one.power_cut) == (False, "code 2")


def test_a_throttle_of_exactly_5_percent_is_not_obeyed():
    bench = cut()
    decoded = decoded_otherwise(bench, "PCU1_Status1", "Throttle", 13, 5.0)
    bench.store.put("PCU1_Status1", decoded, START_NS + 450 * MS)
    assert bench.at(500).controllers["PCU1"].obeyed is False


def test_each_status_is_judged_anew():
    bench = cut().status(450, PowerCut=0)
    assert bench.at(450).stage is StopStage.NOT_OBEYED
    assert bench.status(500).at(500).stage is StopStage.CUT


def test_not_obeyed_is_said_though_the_other_one_has_sent_nothing_or_the_bus_is_gone():
    bench = Bench().until(0, "PCU1").status(100, "PCU1", PowerCut=0)
    assert bench.at(100).stage is StopStage.NOT_OBEYED
    assert cut().status(500, "PCU1", PowerCut=0).at(1000).stage is StopStage.NOT_OBEYED


@pytest.mark.parametrize(("age_ms", "obeyed"), [(1600, True), (1600.000001, None)])
def test_a_status_older_than_1600_ms_says_nothing(age_ms, obeyed):
    bench = Bench().until(3000).status(500, "PCU1").status(2000, "PCU2")
    one = bench.at(500 + age_ms).controllers["PCU1"]
    assert one.obeyed is obeyed
    assert (one.judged_ns, one.power_cut, one.throttle_pct) == (
        (START_NS + 500 * MS, "cut", 0.0) if obeyed else (None, None, None)
    )


@pytest.mark.parametrize(("ahead_ms", "obeyed"), [(20, True), (20.000001, None)])
def test_a_status_from_the_future_says_nothing(ahead_ms, obeyed):
    stop = Bench().until(500).status(500 + ahead_ms).at(500)
    assert stop.controllers["PCU1"].obeyed is obeyed


@pytest.mark.parametrize(("at_ms", "overdue"), [(1649.999999, ()), (1650, ("PCU1",))])
def test_one_that_does_not_confirm_is_missing_from_1600_ms_after_the_first_echo(at_ms, overdue):
    bench = Bench().send(0)
    for echoed_ms in range(50, 1651, 50):
        bench.on_bus(echoed_ms)
    stop = bench.status(500, "PCU2").at(at_ms)
    assert stop.stage is StopStage.ON_BUS
    assert stop.overdue == overdue
    assert stop.sentence() == (
        "Stop sent; PCU1 does not confirm"
        if overdue
        else "Stop on the bus; waiting for PCU1 to confirm"
    )
    expected = "does not confirm" if overdue else "has not confirmed yet"
    assert [stop.missing(name) for name in BOTH] == [expected, ""]


def test_both_that_are_waited_for_or_do_not_confirm_are_named():
    bench = Bench().until(1600)
    waiting = "Stop on the bus; waiting for PCU1 and PCU2 to confirm"
    assert bench.at(1599).sentence() == waiting
    assert bench.at(1600).sentence() == "Stop sent; PCU1 and PCU2 do not confirm"


def test_one_that_confirmed_and_falls_silent_does_not_confirm_any_more():
    bench = Bench().until(2150).status(500, "PCU1").status(2000, "PCU2")
    assert bench.at(2100).stage is StopStage.CUT
    assert bench.at(2101).sentence() == "Stop sent; PCU1 does not confirm"


def test_where_nothing_came_back_nobody_is_overdue():
    bench = Bench()
    for sent_ms in range(0, 3001, 50):
        bench.send(sent_ms)
    stop = bench.at(3000)
    assert (stop.stage, stop.overdue) == (StopStage.SENT, ())
