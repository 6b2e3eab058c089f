"""The demand of an asyncio owner: what differs from the thread's, and that the rest is shared."""

import asyncio
import threading
import time

import pytest

from tests.client.fake_gateway import PATIENCE_S
from tests.client.scripted_gateway import Scripted
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.client import (
    ApiError,
    ApiTimeoutError,
    AsyncClient,
    ClientError,
    RefusedError,
    UnreachableError,
    async_demand,
)

TTL_MS = 60
LONG_TTL_MS = 3000


def throttles(fake):
    return [demand.throttle_pct for demand in fake.demands()]


async def until(condition):
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.001)


def other_tasks():
    return asyncio.all_tasks() - {asyncio.current_task()}


def assert_left_with_no_motion_and_released(fake):
    fake.wait_for(lambda: not fake.open_connections)
    assert fake.methods()[-2:] == ["demand.set", "demand.release"]
    assert throttles(fake)[-1] == 0


def test_what_was_set_reaches_the_command(gateway, fake):
    async def drive():
        async with AsyncClient(gateway) as client:
            async with client.demand("driver", ttl_ms=LONG_TTL_MS) as owner:
                assert (await client.arm())["mode"] == "active"
                owner.set(throttle_pct=20)
                await until(lambda: owner.last_answer["mode"] == "active")
                assert owner.connected
                command = (await client.state([]))["commands"]["PCU1"]
                assert command["throttle_pct"] == 20
            fake.wait_for(lambda: len(fake.open_connections) == 1)
            assert (await client.state([]))["mode"] == "standby"

    asyncio.run(drive())


def test_set_sends_before_anything_else_gets_a_turn(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver") as owner:
            owner.set(throttle_pct=20)
            fake.wait_for(lambda: throttles(fake)[-1] == 20)

    asyncio.run(drive())


def test_when_the_hold_ends_no_motion_is_sent(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver", ttl_ms=TTL_MS, hold_s=0.1) as owner:
            owner.set(throttle_pct=33)
            await until(lambda: 33 in throttles(fake) and throttles(fake)[-2:] == [0, 0])

    asyncio.run(drive())


def test_without_a_hold_the_values_go_on(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver", ttl_ms=TTL_MS, hold_s=None) as owner:
            owner.set(throttle_pct=33)
            await until(lambda: throttles(fake).count(33) >= 5)

    asyncio.run(drive())


def test_keeping_a_demand_costs_next_to_no_processor_time(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver", ttl_ms=300, hold_s=None) as owner:
            before_cpu_s = time.process_time()
            await asyncio.sleep(0.5)
            assert time.process_time() - before_cpu_s < 0.1
            assert len(fake.demands()) >= 2
            fake.stop()
            await until(lambda: not owner.connected)
            before_cpu_s = time.process_time()
            await asyncio.sleep(0.3)
            assert time.process_time() - before_cpu_s < 0.06

    asyncio.run(drive())


def test_nothing_can_be_set_before_it_is_entered(gateway):
    async def drive():
        with pytest.raises(ClientError, match="not entered"):
            AsyncClient(gateway).demand("driver").set(throttle_pct=1)

    asyncio.run(drive())


def test_a_loop_that_is_blocked_lets_the_demand_expire(gateway, fake):
    async def drive():
        async with AsyncClient(gateway) as client, client.demand("driver", ttl_ms=TTL_MS) as owner:
            owner.set(throttle_pct=33)
            fake.wait_for(lambda: throttles(fake)[-1] == 33)
            seen, made_ns = len(fake.demands()), time.monotonic_ns()
            while time.monotonic_ns() < made_ns + 2 * TTL_MS * 1_000_000:
                pass
            assert len(fake.demands()) == seen

    asyncio.run(drive())


def test_leaving_by_an_exception_asks_for_no_motion_and_lets_it_pass(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver", hold_s=None) as owner:
            owner.set(throttle_pct=50)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        asyncio.run(drive())
    assert_left_with_no_motion_and_released(fake)


def test_a_cancelled_drive_asks_for_no_motion_and_leaves_no_task(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver", hold_s=None) as owner:
            owner.set(throttle_pct=50)
            await asyncio.Event().wait()

    async def main():
        driving = asyncio.create_task(drive())
        await until(lambda: 50 in throttles(fake))
        driving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await driving
        assert not other_tasks()

    asyncio.run(main())
    assert_left_with_no_motion_and_released(fake)


def test_a_drive_cancelled_again_while_leaving_still_asked_for_no_motion(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver", hold_s=None) as owner:
            owner.set(throttle_pct=50)
            fake.faults.silent.add("demand.set")
            await asyncio.Event().wait()

    async def main():
        driving = asyncio.create_task(drive())
        await until(lambda: 50 in throttles(fake))
        driving.cancel()
        await until(lambda: throttles(fake)[-1] == 0)
        driving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await driving
        await until(lambda: not other_tasks())

    asyncio.run(main())
    fake.wait_for(lambda: not fake.open_connections)


def test_a_drive_cancelled_while_it_is_entered_leaves_nothing(gateway, fake):
    fake.faults.silent.add("demand.set")

    async def drive():
        async with AsyncClient(gateway).demand("driver"):
            pytest.fail("it was entered")

    async def main():
        driving = asyncio.create_task(drive())
        await until(fake.demands)
        driving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await driving
        assert not other_tasks()

    asyncio.run(main())
    fake.wait_for(lambda: not fake.open_connections)


def test_leaving_leaves_no_task(gateway):
    async def drive():
        async with AsyncClient(gateway).demand("driver"):
            assert [task.get_name() for task in other_tasks()] == ["demand driver"]
        assert not other_tasks()

    asyncio.run(drive())


def test_no_motion_is_answered_before_the_demand_is_released(tmp_path, monkeypatch):
    monkeypatch.setattr(async_demand, "RELEASE_TIMEOUT_S", PATIENCE_S)

    def speak(gateway):
        gateway.grant()
        assert gateway.read()["params"]["values"]["throttle_pct"] == 0
        assert gateway.has_nothing_to_read()
        gateway.grant(gateway.last)
        assert gateway.read()["method"] == "demand.release"
        gateway.grant(gateway.last)

    async def drive():
        with Scripted(tmp_path / "scripted.sock") as gateway:
            speaking = asyncio.create_task(asyncio.to_thread(speak, gateway))
            async with AsyncClient(gateway.path, timeout_s=60).demand("driver", ttl_ms=60_000):
                pass
            await speaking

    asyncio.run(drive())


def test_releasing_by_hand_ends_it_and_once_more_does_nothing(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver") as owner:
            await owner.release()
            assert_left_with_no_motion_and_released(fake)
            assert not owner.connected
            with pytest.raises(ClientError, match="released"):
                owner.set(throttle_pct=1)
            with pytest.raises(ClientError, match="again"):
                await owner.__aenter__()

    asyncio.run(drive())
    assert fake.methods().count("demand.release") == 1


def test_a_refusal_is_readable_and_raised_by_the_next_set(gateway):
    async def drive():
        async with AsyncClient(gateway).demand("driver") as owner:
            owner.set(throttle_pct=101)
            await until(lambda: owner.refusal is not None)
            with pytest.raises(RefusedError, match="must be 0 to 100"):
                owner.set(throttle_pct=20)

    asyncio.run(drive())


def test_a_demand_that_is_refused_from_the_start_is_not_entered(gateway, fake):
    failure = RequestError(ErrorCode.REFUSED, "cruise owns the demand", "other_owner")
    fake.faults.refuse["demand.set"] = failure

    async def drive():
        with pytest.raises(RefusedError, match="cruise owns"):
            async with AsyncClient(gateway, timeout_s=60).demand("driver"):
                pytest.fail("it was entered")
        assert not other_tasks()

    asyncio.run(drive())


def test_entering_without_a_gateway_is_unreachable(tmp_path):
    async def drive():
        async with AsyncClient(tmp_path / "none.sock").demand("driver"):
            pytest.fail("it was entered")

    with pytest.raises(UnreachableError):
        asyncio.run(drive())


def test_a_gateway_that_does_not_answer_the_first_demand_is_a_timeout(gateway, fake):
    fake.faults.silent.add("demand.set")

    async def drive():
        with pytest.raises(ApiTimeoutError, match="took no demand within"):
            async with AsyncClient(gateway, timeout_s=0.1).demand("driver"):
                pytest.fail("it was entered")
        assert not other_tasks()

    asyncio.run(drive())


def test_an_owner_reconnects_with_no_motion_and_rising_sequences(gateway, fake):
    async def drive():
        async with AsyncClient(gateway).demand("driver", ttl_ms=TTL_MS, hold_s=None) as owner:
            owner.set(throttle_pct=50)
            await until(lambda: 50 in throttles(fake))
            old = fake.demands()[-1].connection
            await asyncio.to_thread(fake.restart)
            await until(lambda: len([d for d in fake.demands() if d.connection > old]) >= 3)
            assert {d.throttle_pct for d in fake.demands() if d.connection > old} == {0}
            owner.set(throttle_pct=30)
            await until(lambda: throttles(fake)[-1] == 30)

    asyncio.run(drive())
    numbers = [demand.params["sequence"] for demand in fake.demands()]
    assert numbers == sorted(set(numbers))


# Calls and subscriptions.


def test_a_cancelled_call_leaves_the_client_usable_and_no_task(gateway, fake):
    async def main():
        fake.faults.late["why"] = threading.Event()
        async with AsyncClient(gateway) as client:
            calling = asyncio.create_task(client.why())
            await until(lambda: "why" in fake.methods())
            calling.cancel()
            with pytest.raises(asyncio.CancelledError):
                await calling
            fake.faults.late.pop("why").set()
            assert "digest" in await client.config()
            assert not other_tasks()

    asyncio.run(main())


def test_many_tasks_share_a_client_and_each_gets_its_own_answer(gateway, fake):
    async def main():
        async with AsyncClient(gateway) as client:
            answers = await asyncio.gather(*(client.events(limit) for limit in range(1, 51)))
        assert [answer["forgotten"] for answer in answers] == list(range(1, 51))

    asyncio.run(main())
    assert fake.accepted == 1


def test_a_request_that_does_not_get_its_turn_in_time_is_not_sent(gateway, fake):
    async def main():
        fake.faults.late["why"] = threading.Event()
        async with AsyncClient(gateway, timeout_s=60) as client:
            waiting = asyncio.create_task(client.why())
            await until(lambda: "why" in fake.methods())
            client.timeout_s = 0.01
            with pytest.raises(ApiTimeoutError, match="arm"):
                await client.arm()
            fake.faults.late["why"].set()
            assert (await waiting)["mode"] == "standby"

    asyncio.run(main())
    assert "arm" not in fake.methods()


def test_a_cancelled_subscription_can_be_read_on_and_leaves_no_task(gateway):
    async def main():
        async with AsyncClient(gateway).subscribe(rate_hz=50) as updates:
            await anext(updates)
            reading = asyncio.create_task(anext(updates))
            await asyncio.sleep(0)
            reading.cancel()
            await asyncio.wait({reading})
            assert (await anext(updates))["state"]["mode"] == "standby"
            assert not other_tasks()

    asyncio.run(main())


def test_a_loop_over_a_subscription_ends_with_its_connection(gateway, fake):
    async def main():
        count = 0
        async for update in AsyncClient(gateway).subscribe(rate_hz=50):
            count += update["state"]["mode"] == "standby"
            if count == 2:
                fake.hang_up()
        assert count >= 2

    asyncio.run(main())


def test_closing_a_subscription_wakes_the_task_that_waits_for_it(gateway, fake):
    async def main():
        updates = AsyncClient(gateway).subscribe(rate_hz=0.1)
        await anext(updates)
        reading = asyncio.create_task(anext(updates, None))
        await asyncio.sleep(0)
        updates.close()
        async with asyncio.timeout(PATIENCE_S):
            assert await reading is None

    asyncio.run(main())
    fake.wait_for(lambda: not fake.open_connections)


def test_a_full_gateway_says_so_to_an_owner_too(gateway, fake):
    fake.faults.full = True

    async def drive():
        async with AsyncClient(gateway).demand("driver"):
            pytest.fail("it was entered")

    with pytest.raises(ApiError) as raised:
        asyncio.run(drive())
    assert raised.value.word == "too_many_clients"
