"""The exporter's reader: what it asks, and what it makes of a gateway that answers badly."""

import threading
import time
from typing import Any

import pytest

from tests.client.fake_gateway import FakeGateway
from tests.recorder.gateway import RecorderProcess
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.client import Client
from vcu_gateway.exporter import FAMILIES, GatewayAnswers, GatewayReader


@pytest.fixture
def fake(tmp_path):
    one = FakeGateway(tmp_path / "control.sock")
    one.start()
    yield one
    one.stop()


@pytest.fixture
def reports():
    return []


@pytest.fixture
def reader(fake, reports):
    with Client(fake.path) as client:
        yield GatewayReader(client, reports.append, 1.0, fake.path.with_name("status.json"))


def test_readings_ask_over_one_connection_and_for_the_configuration_once(fake, reader):
    for _ in range(3):
        assert None not in reader.read()[:5]
    assert fake.accepted == 1
    assert fake.methods() == ["health", "state.get", "why", "config.get", "tuning.get"] + (
        ["health", "state.get", "why", "tuning.get"] * 2
    )


def test_a_gateway_that_is_gone_and_back_is_reported_once_each(fake, reader, reports):
    reader.read()
    fake.stop()
    assert [reader.read() for _ in range(3)] == [GatewayAnswers()] * 3
    fake.start()
    assert reader.read().health is not None
    assert reader.read().health is not None
    assert [report.split(":")[0] for report in reports] == [
        "the gateway answers",
        "no metrics of the gateway",
        "the gateway answers",
    ]
    assert "systemctl start vcu-gateway" in reports[1]


def test_a_connection_that_broke_is_opened_again(fake, reader):
    reader.read()
    fake.hang_up()
    assert None not in reader.read()[:5]
    assert fake.accepted == 2


def test_before_the_first_tick_there_is_health_alone(fake, reader):
    not_ready = RequestError(ErrorCode.NOT_READY, "the gateway has not ticked yet")
    fake.faults.refuse = {"state.get": not_ready, "why": not_ready}
    reading = reader.read()
    assert (reading.state, reading.why) == (None, None)
    assert reading.health is not None
    assert reading.config is not None


def test_an_older_gateway_is_answered_with_what_there_is():
    answers: dict[str, Any] = {"health": {"ticks": {"done": 7}}, "why": {"mode": "standby"}}
    old = GatewayAnswers(**answers)
    samples = {family.name: family.samples(old) for family in FAMILIES}
    assert samples["vcu_gateway_up"] == {(): 1}
    assert samples["vcu_gateway_ticks_total"] == {(): 7}
    assert samples["vcu_gateway_mode"][("standby",)] == 1
    assert samples["vcu_gateway_tick_lateness_seconds"] == {}
    assert samples["vcu_gateway_demand_throttle_ratio"] == {}
    assert samples["vcu_gateway_drive_mode"] == {}


def test_a_gateway_that_does_not_answer_costs_the_time_limit_and_no_more(fake, reader, reports):
    fake.faults.late["health"] = threading.Event()
    begin_s = time.monotonic()
    assert reader.read() == GatewayAnswers()
    assert 1.0 <= time.monotonic() - begin_s < 5.0
    assert "no answer to health within 1 s" in reports[0]


def test_what_comes_too_late_is_absent_and_the_rest_is_there(fake, reader):
    fake.faults.late["why"] = threading.Event()
    begin_s = time.monotonic()
    reading = reader.read()
    assert time.monotonic() - begin_s < 5.0
    assert (reading.health is not None, reading.state is not None) == (True, True)
    assert (reading.why, reading.config) == (None, None)
    fake.faults.late.pop("why").set()
    assert None not in reader.read()[:5]


def test_readings_that_wait_for_each_other_are_one(fake, reader):
    gate = fake.faults.late["why"] = threading.Event()
    reader.read()  # a warm connection; it ends with the time limit
    fake.seen.clear()
    found: list[GatewayAnswers] = []
    threads = [threading.Thread(target=lambda: found.append(reader.read())) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    gate.set()
    assert len(found) == 8
    assert fake.methods().count("health") <= 2  # of the first, and of those that came meanwhile


def test_the_recorder_is_read_also_where_the_gateway_does_not_answer(fake, tmp_path):
    recorder = RecorderProcess(tmp_path)
    recorder.wait_for(lambda status: status["pid"])
    fake.stop()
    with Client(fake.path) as client:
        answers = GatewayReader(client, print, 1.0, recorder.status_path).read()
    recorder.close()
    assert answers.health is None
    assert answers.recorder is not None
    assert answers.recorder.pid == recorder.process.pid
    assert 0 <= answers.recorder_age_s < 10
