"""Requests: what they tell, and what a reload reaches; SAFETY.md's sentences: test_gateway.py."""

from dataclasses import replace

from tests.core.safety_world import MS, PERIOD_NS, active, standby
from vcu_gateway.core.demand import ControllerDemand, Demand
from vcu_gateway.core.supervisor import Mode


def owners(drive) -> list[object]:
    drive.tick()
    return [event.fields["source"] for event in drive.events if event.name == "demand_owner"]


def demand_of(source: str, sequence: int = 1, ttl_ms: int = 200) -> Demand:
    both = {"PCU1": ControllerDemand(), "PCU2": ControllerDemand()}
    return Demand(source, sequence, ttl_ms, both)


def test_a_new_owner_of_the_demand_is_told_once():
    drive = standby()
    drive.asked = None
    drive.run(400)
    for sequence in (1, 2):
        drive.gateway.requests.offer(demand_of("remote", sequence), drive.now_ns)
    assert owners(drive) == ["driver", "remote"]


def test_a_refused_source_is_no_owner():
    drive = standby()
    assert not drive.gateway.requests.offer(demand_of("remote"), drive.now_ns).granted
    assert owners(drive) == ["driver"]


def test_the_time_that_a_demand_waited_counts_for_the_tracks_of_the_pedal():
    drive = active()
    drive.asked = None
    apart = ControllerDemand(20.0, throttle_track2_pct=40.0)
    assert drive.offer(apart, made_ns=drive.now_ns - 60 * MS).granted
    drive.tick()
    assert "the pedal's tracks differ" in drive.sentence


def test_a_request_to_arm_that_comes_too_late_finds_the_fault_of_the_late_tick():
    drive = active()
    drive.now_ns += 5 * PERIOD_NS + 1
    assert drive.arm().sentence == "arming needs standby, the mode is fault"


def test_a_reload_reaches_the_gate():
    drive = active()
    requests = drive.gateway.requests
    assert requests.reload(replace(requests.settings, power_limit_max_w=1000.0)).granted
    assert drive.gateway.output.gate.limits.power_limit_max_w == 1000.0


def test_the_bench_demand_asks_for_no_throttle_before_it_is_armed():
    bench = ControllerDemand(throttle_pct=30)
    drive = standby(bench_demand=bench)
    assert drive.mode is Mode.STANDBY
    asked = drive.gateway.requests.asked(drive.now_ns)
    assert {one.throttle_pct for one in asked.values()} == {0.0}


def test_without_any_demand_nothing_is_asked():
    drive = standby()
    drive.gateway.requests.desk.end("driver")
    assert drive.gateway.requests.asked(drive.now_ns) is None
