"""A new configuration while the gateway runs: all of it or nothing, and no looser while active."""

import dataclasses
import itertools
import os
import signal
import subprocess
import sys
import threading
from typing import Any

import pytest

from tests.config.test_config import LEAVES, one_key
from tests.core.test_settings import OTHER_VALUES, STRICTER_AND_LOOSER
from tests.driven import driven, wait_until
from vcu_gateway import config as configuration
from vcu_gateway.client import ConfigRefusedError
from vcu_gateway.config import core_settings, parse
from vcu_gateway.config.tuning import TUNING_SECTIONS
from vcu_gateway.core.settings import RESTART_ONLY, changed
from vcu_gateway.daemon.reload import changed as changed_keys
from vcu_gateway.daemon.reload import is_live


def problems(client) -> tuple[str, ...]:
    with pytest.raises(ConfigRefusedError) as caught:
        client.reload()
    return caught.value.problems


def test_a_changed_limit_is_in_effect_after_a_reload(fresh):
    with fresh.client() as client:
        before = client.config()["digest"]
        fresh.configure("limits: {speed_limit_max_rpm: 3000}\n")
        reloaded = client.reload()
        assert reloaded["changed"] == ["limits.speed_limit_max_rpm"]
        assert reloaded["digest"] == client.health()["config_digest"] != before
        fresh.until(
            lambda: client.state(())["commands"]["PCU1"]["speed_limit_rpm"] == 3000, "the limit"
        )
        names = [event["name"] for event in client.events()["events"]]
        assert "config_reloaded" in names


@pytest.mark.clock
def test_a_stricter_power_maximum_is_a_ramp_for_a_demand_that_names_no_power(fresh):
    powers_w = []
    with fresh.client() as client, client.demand("driver"):
        client.arm()
        fresh.loop.add_observer(
            lambda result: powers_w.append(result.commands["PCU1"].power_limit_w)
        )
        fresh.until(lambda: 60_000 in powers_w, "full power")
        fresh.configure("limits: {power_limit_max_w: 45000}\n")
        client.reload()
        fresh.until(lambda: powers_w[-1] == 45_000, "the stricter maximum")
    driven = powers_w[: powers_w.index(45_000) + 1]
    assert all(before - after <= 3_000 for before, after in itertools.pairwise(driven))
    assert len({one for one in driven if 45_000 < one < 60_000}) >= 4


def test_an_invalid_file_changes_nothing_and_says_why_with_its_line(fresh):
    with fresh.client() as client:
        before = client.config()
        fresh.configure("limits:\n  speed_limit_max_rpm: 3000\n  power_limit_max_w: -1\n")
        (problem,) = problems(client)
        assert problem.startswith(f"{fresh.file}:6: limits.power_limit_max_w: must be at least 0 W")
        assert client.config() == before
        fresh.file.unlink()
        assert "gateway.yaml" in problems(client)[0]
        assert client.config() == before


def test_a_reload_beside_another_one_is_refused_and_the_next_is_taken(fresh):
    with fresh.client() as client:
        with fresh.api.reloader._busy:
            assert problems(client) == ("a reload is under way already",)
        assert client.reload()["changed"] == []


def test_a_reload_that_gets_no_thread_is_refused_and_the_next_is_taken(fresh, monkeypatch):
    def no_thread(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with fresh.client() as client:
        with monkeypatch.context() as starved:
            starved.setattr(threading.Thread, "start", no_thread)
            (problem,) = problems(client)
        assert problem == "a reload cannot be begun: can't start new thread"
        assert fresh.mode == "standby"
        assert client.reload()["changed"] == []


def test_keys_that_need_a_restart_are_named_and_nothing_is_taken(fresh):
    with fresh.client() as client:
        before = client.config()
        fresh.configure(
            "limits: {speed_limit_max_rpm: 3000}\nlog: {level: debug}\n"
            "safety: {listen_before_talk_ms: 2000}\n"
        )
        assert problems(client) == (
            "safety.listen_before_talk_ms needs a restart",
            "log.level needs a restart",
        )
        assert client.config() == before


@pytest.mark.clock
def test_while_active_only_stricter_limits_are_taken(fresh):
    with fresh.client() as client, client.demand("driver", hold_s=None):
        client.arm()
        fresh.configure("limits: {throttle_slew_pct_per_s: 200}\n")
        assert problems(client) == (
            "limits.throttle_slew_pct_per_s may only become smaller while active",
        )
        fresh.configure("limits: {power_slew_w_per_s: 50000, regen_min_rpm: 50}\n")
        assert problems(client) == (
            "limits.power_slew_w_per_s cannot change while active; disarm first",
            "limits.regen_min_rpm may only become larger while active",
        )
        fresh.configure("limits: {throttle_slew_pct_per_s: 50}\n")
        assert client.reload()["changed"] == ["limits.throttle_slew_pct_per_s"]
        assert fresh.mode == "active"


CURVE = "curves: {{power_limit_w: {{by_motor_temperature_c: [[95, 14000], [110, {}]]}}}}\n"
MODES = "drive_modes: {{start: {}, modes: {{eco: {{power_limit_w: {}}}, sport: {{}}}}}}\n"
SLIP = "vehicle: {motor_rpm_per_kmh: 85.3}\nlaws: {slip: {}}\n"


@pytest.mark.clock
def test_while_active_a_curve_that_is_nowhere_higher_is_taken_and_nothing_else_of_the_tuning(fresh):
    modes = MODES.format("eco", 8000)
    curve = "curves.power_limit_w.by_motor_temperature_c"
    fresh.configure(CURVE.format(6000) + modes)
    with fresh.client() as client:
        # The modes are new, and their start is read at the start.
        assert problems(client) == ("drive_modes.start needs a restart",)
        fresh.configure(CURVE.format(6000))
        assert client.reload()["changed"] == [curve]
        with client.demand("driver", hold_s=None):
            client.arm()
            fresh.configure(CURVE.format(7000))
            looser = f"{curve} may only become a curve that is nowhere higher while active"
            assert problems(client) == (looser,)
            fresh.configure("")
            assert problems(client) == (looser,)
            fresh.configure(CURVE.format(6000) + SLIP)
            refused = problems(client)
            assert "laws.slip.allowed_kmh cannot change while active; disarm first" in refused
            assert all("while active" in one for one in refused)
            fresh.configure(CURVE.format(0))
            assert client.reload()["changed"] == [curve]
            assert fresh.mode == "active"


def test_a_drive_mode_changes_in_standby_and_one_in_use_stays(tmp_path):
    with driven(tmp_path, MODES.format("eco", 8000)) as one:
        one.until_ready()
        with one.client() as client:
            one.configure(MODES.format("eco", 5000))
            assert client.reload()["changed"] == ["drive_modes.modes.eco.power_limit_w"]
            one.configure(MODES.format("sport", 5000))
            assert problems(client) == ("drive_modes.start needs a restart",)
            client.set_drive_mode("sport")
            one.configure("drive_modes: {start: eco, modes: {eco: {}}}\n")
            assert problems(client) == ("drive mode sport is in use",)


def test_every_key_is_taken_by_a_running_gateway_or_named_as_needing_a_restart():
    """What is live changes the settings, and nothing of it is read at the start only."""
    before = configuration.Config()
    for name, value in OTHER.items():
        after = parse(one_key(name, value), "gateway.yaml")
        assert changed_keys(before, after) == (name,)
        settings = changed(core_settings(before), core_settings(after))
        assert settings, name
        assert not set(settings) & set(RESTART_ONLY), name


def other_value(key: str) -> Any:
    """A value that the file may say, other than the default."""
    name = key.rpartition(".")[2]
    return STRICTER_AND_LOOSER[name][0] if name in STRICTER_AND_LOOSER else OTHER_VALUES[name]


OTHER = {
    name: other_value(name)
    for name in LEAVES
    if is_live(name) and name.partition(".")[0] not in TUNING_SECTIONS
}


def test_every_setting_that_a_running_gateway_takes_comes_from_a_live_key():
    live = {name for key in OTHER for name in settings_of(key)}
    fields = {field.name for field in dataclasses.fields(core_settings(configuration.Config()))}
    assert live == fields - {*RESTART_ONLY, "tuning"}  # its keys: tests/config/test_tuning.py


def settings_of(key: str) -> tuple[str, ...]:
    after = parse(one_key(key, OTHER[key]), "gateway.yaml")
    return changed(core_settings(configuration.Config()), core_settings(after))


def test_a_hangup_signal_reloads_and_an_invalid_file_does_not_end_the_process(tmp_path):
    file, log = tmp_path / "gateway.yaml", tmp_path / "log"
    head = f"bus: {{interface: virtual, channel: x}}\napi: {{socket_path: {tmp_path / 'c.sock'}}}\n"
    file.write_text(head)
    command = [sys.executable, "-m", "vcu_gateway", "run", "-c", str(file)]
    with log.open("wb") as stderr, subprocess.Popen(command, stderr=stderr) as gateway:
        try:
            wait_until(lambda: "link_open" in log.read_text(), "the start")
            file.write_text(head + "limits: {power_limit_max_w: 1}\n")
            gateway.send_signal(signal.SIGHUP)
            wait_until(lambda: "config_reloaded" in log.read_text(), "the reload")
            file.write_text("nonsense")
            gateway.send_signal(signal.SIGHUP)
            wait_until(lambda: "config_refused" in log.read_text(), "the refusal")
        finally:
            gateway.send_signal(signal.SIGTERM)
        assert gateway.wait(60) == 0
    assert not os.path.exists(tmp_path / "c.sock")
