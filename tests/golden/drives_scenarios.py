"""Golden drives of the simulator's scenarios: one for each file of config/scenarios."""

from tests.core.simulated_drive import CODEC
from tests.golden.scripted_drive import RELEASED, ScriptedDrive
from tests.golden.scripts import DEFAULTS, DRIVES, GoldenDrive
from tests.golden.simulate import SCENARIOS
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.simulator.scenario import load
from vcu_gateway.units import NS_PER_S

AFTERWARDS_S = 3.0
# What a file itself says is to be seen with: a demand that brakes, and regeneration to the end.
BRAKING = {"overcharge": "limits: {regen_min_rpm: 0}"}
HEARD = ("imu-silent", "corrupt-bus", "lossy-bus")  # with the inertial unit


def drive_scenario(drive: ScriptedDrive, end_s: float, braking: bool) -> None:
    """Drive until the scenario is over, and try to go on after each fault."""
    drive.start_driving(power_mode=PowerMode.TURBO)
    while drive.now_ns - drive.start_ns < end_s * NS_PER_S:
        if drive.gateway.supervisor.mode is Mode.ACTIVE:
            asked = {"brake_pct": 50.0, "regen_brake": True, "throttle_pct": 0.0} if braking else {}
            drive.demand(power_mode=PowerMode.TURBO, **asked)
        else:
            drive.demanded = RELEASED
            drive.ticks(20)
            drive.reset()
            drive.arm()
        drive.ticks(5)


def _golden(name: str) -> GoldenDrive:
    scenario = load(SCENARIOS / f"{name}.yaml", CODEC.protocol)
    ends_s = [step.at_s + (step.for_s or AFTERWARDS_S) for step in scenario.steps]
    end_s = max(ends_s) + AFTERWARDS_S

    def script(drive: ScriptedDrive) -> None:
        drive_scenario(drive, end_s, braking=name in BRAKING)

    script.__doc__ = f"The scenario {name}, as config/scenarios has it."
    config = BRAKING.get(name, DEFAULTS)
    return GoldenDrive(
        f"scenario-{name}", script, config, quiet=name not in HEARD, scenario=f"{name}.yaml"
    )


for _path in sorted(SCENARIOS.glob("*.yaml")):
    DRIVES[f"scenario-{_path.stem}"] = _golden(_path.stem)
