"""Threads that share a synchronous client, and one that waits while another ends it."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.client.fake_gateway import PATIENCE_S
from vcu_gateway.client import ApiTimeoutError, Client


def test_many_threads_share_a_client_and_each_gets_its_own_answer(gateway, fake):
    limits = [*range(1, 201)]
    with Client(gateway) as client, ThreadPoolExecutor(8) as threads:
        answers = list(threads.map(client.events, limits))
    assert [answer["forgotten"] for answer in answers] == limits
    assert fake.accepted == 1


def test_threads_share_a_client_while_the_gateway_restarts(gateway, fake):
    with Client(gateway, timeout_s=PATIENCE_S) as client, ThreadPoolExecutor(4) as threads:
        client.why()
        calls = [threads.submit(client.why) for _ in range(50)]
        fake.hang_up()
        calls += [threads.submit(client.why) for _ in range(50)]
        assert all(call.result()["mode"] == "standby" for call in calls)


def test_a_request_that_does_not_get_its_turn_in_time_is_not_sent(gateway, fake):
    fake.faults.late["why"] = threading.Event()
    with Client(gateway, timeout_s=PATIENCE_S) as client, ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(client.why)
        fake.wait_for(lambda: "why" in fake.methods())
        client.timeout_s = 0.01
        with pytest.raises(ApiTimeoutError, match="arm was not sent"):
            client.arm()
        fake.faults.late["why"].set()
        assert waiting.result()["mode"] == "standby"
    assert "arm" not in fake.methods()


def test_closing_a_subscription_wakes_the_thread_that_waits_for_it(gateway, fake):
    with Client(gateway, timeout_s=PATIENCE_S) as client, ThreadPoolExecutor(1) as threads:
        updates = client.subscribe(rate_hz=0.1)
        next(updates)
        waiting = threads.submit(next, updates, None)
        updates.close()
        assert waiting.result(PATIENCE_S) is None
    fake.wait_for(lambda: not fake.open_connections)


def test_a_subscription_and_a_demand_do_not_wait_for_calls(gateway, fake):
    fake.faults.late["why"] = threading.Event()
    with Client(gateway) as client, ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(client.why)
        fake.wait_for(lambda: "why" in fake.methods())
        with client.demand("driver"), client.subscribe() as updates:
            assert next(updates)["lost"] == 0
        fake.faults.late["why"].set()
        waiting.result()
