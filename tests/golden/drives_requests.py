"""Golden drives of what is asked of the gateway: demands, arming, resetting, reloads."""

from dataclasses import replace

from tests.golden.scripted_drive import CRUISE, MS, RELEASED, ScriptedDrive
from tests.golden.scripts import golden
from vcu_gateway.core import calls
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode

OUT_OF_RANGE: tuple[dict, ...] = (
    {"throttle_pct": 100.1},
    {"throttle_pct": -0.1},
    {"brake_pct": 101.0},
    {"speed_limit_rpm": 12001.0},
)


@golden(70)
def silent_driver(drive: ScriptedDrive) -> None:
    """The driver's program stops, ends its demand, and makes demands that are already old."""
    drive.start_driving()
    drive.demanded = None
    drive.run(1000)
    drive.start_driving()
    drive.gateway.apply(calls.EndDemand("somebody", drive.now_ns))
    drive.ticks(2)
    drive.demanded = None
    drive.gateway.apply(calls.EndDemand("driver", drive.now_ns))
    drive.run(300)
    drive.start_driving()
    drive.demanded = None
    for age_ms in (0, 100, 149, 150, 151, 199, 200, 201, 400):
        drive.offer(CRUISE, made_ns=drive.now_ns - age_ms * MS)
        drive.ticks(1)
    drive.run(400)
    drive.offer(CRUISE, made_ns=drive.now_ns + 60 * MS)
    drive.offer(CRUISE, made_ns=drive.now_ns + 5 * MS)
    drive.run(200)


@golden(70)
def interrupted_demand(drive: ScriptedDrive) -> None:
    """A released pedal counts anew after a pause: arming waits for it again."""
    drive.until(Mode.STANDBY)
    drive.run(600)
    drive.demanded = None
    drive.run(300)
    drive.demanded = RELEASED
    for _ in range(12):
        drive.ticks(1)
        drive.arm()


@golden(71, config="demand: {priorities: {remote_stop: 10}}")
def two_drivers(drive: ScriptedDrive) -> None:
    """A second driver, refused while the first is fresh; one of higher priority takes over."""
    drive.start_driving()
    drive.source = "another"
    drive.run(600)
    drive.source = "driver"
    drive.start_driving()
    drive.source = "remote_stop"
    drive.demand(throttle_pct=20.0)
    drive.run(500)
    drive.demand(throttle_pct=0.0)
    drive.run(300)
    drive.demand()
    drive.run(600)
    drive.source = "driver"
    drive.run(500)
    drive.demanded = None
    drive.run(500)


@golden()
def too_many_sources(drive: ScriptedDrive) -> None:
    """One source after the other asks: the 65th is one too many, those before may ask again."""
    drive.ttl_ms = 1
    for number in (*range(65), 0, 63):
        drive.source = f"source {number}"
        drive.ticks(1)


@golden(72, 82)
def sequences(drive: ScriptedDrive) -> None:
    """Old and repeated sequence numbers, times to live and values out of range."""
    drive.start_driving()
    for sequence in (1, drive.sequence, drive.sequence + 2, 2**31, 2**53, 2**63 - 1):
        drive.offer(CRUISE, sequence=sequence)
        drive.wait_until(drive.tick_ns)
        drive.tick_now()
        drive.tick_ns += 50 * MS
    for changes in (
        {"ttl_ms": 0},
        {"ttl_ms": 49},
        {"ttl_ms": 1001},
        {"ttl_ms": 1000},
        {"source": "bench"},
    ):
        drive.offer(CRUISE, source="x", **changes) if "source" not in changes else drive.offer(
            CRUISE, **changes
        )
        drive.wait_until(drive.now_ns + MS)
    for changes in OUT_OF_RANGE:
        demanded = replace(CRUISE, **changes)
        drive.offer(demanded, source="x", sequence=drive.sequence + 2**20)
    drive.offer({"PCU1": CRUISE}, source="y")
    drive.run(400)


@golden(52, 62)
def reloads(drive: ScriptedDrive) -> None:
    """Stricter, looser and restart-only settings, while driving and while not."""
    drive.start_driving(throttle_pct=100)
    drive.run(1500)
    now = Settings()
    for changes in (
        {"power_limit_max_w": 20_000}, {"power_limit_max_w": 40_000},
        {"speed_limit_max_rpm": 3_000},
        {"transmit_priority": 3}, {"throttle_slew_pct_per_s": 30.0}, {"regen_min_rpm": 50.0},
        {"direction_change_rpm": 20.0}, {"clear_hold_ms": 2_000}, {"power_slew_w_per_s": 30_000.0},
    ):  # fmt: skip
        after = replace(now, **changes)
        if drive.gateway.apply(calls.ReloadSettings(after)).granted:
            now = after
        drive.run(500)
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(200)
    drive.gateway.apply(calls.ReloadSettings(Settings()))
    drive.run(300)
    drive.gateway.apply(
        calls.ReloadSettings(
            Settings(
                required_messages=("BMS_Status", "PCU1_Status2", "PCU2_Status2", "IMU_Attitude")
            )
        )
    )
    drive.run(1500)
    drive.arm()
    drive.run(200)


@golden()
def requests_in_every_mode(drive: ScriptedDrive) -> None:
    """Every request in every mode, the end of it all last."""

    def ask() -> None:
        drive.arm()
        drive.ticks(1)
        drive.gateway.apply(calls.Disarm(drive.now_ns))
        drive.ticks(1)
        drive.reset(FaultClass.DRIVER)
        drive.ticks(1)

    ask()
    drive.until(Mode.STANDBY)
    drive.run(600)
    ask()
    drive.start_driving()
    ask()
    drive.gateway.apply(calls.EmergencyStop())
    drive.run(100)
    ask()
    drive.run(1500)
    drive.reset()
    drive.start_driving()
    drive.break_with({"fault": "silence", "of": "BMS"})
    drive.run(2500)
    ask()
    drive.break_with()
    drive.run(1500)
    drive.start_driving()
    drive.gateway.apply(calls.Terminate())
    drive.ticks(2)
    drive.gateway.apply(calls.EmergencyStop())
    ask()
    drive.receive(0x0008A7D0, bytes(8))
    drive.ticks(2)
