"""A gateway program in simulated time, and its metrics as Prometheus would read them."""

import json
from typing import Any

from prometheus_client import Metric, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from tests.core.simulated_drive import COMMAND_IDS, Drive, active
from tests.recorder.told import STATUS
from vcu_gateway import config as configuration
from vcu_gateway.api.results import ApiCounts
from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.config import Config
from vcu_gateway.core import calls
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.tuning import DriveMode, Tuning
from vcu_gateway.daemon.loop import LastTick, TickLoop
from vcu_gateway.daemon.restart_state import CountedStart
from vcu_gateway.exporter import GatewayAnswers, prometheus
from vcu_gateway.recording.recorder_status import RecorderStatus
from vcu_gateway.server import views
from vcu_gateway.server.queries import RunFacts, health

Labels = frozenset[tuple[str, str]]
MOTOR = "curves.power_limit_w.by_motor_temperature_c"
TUNED = Tuning(
    curves={"power_limit_w.by_motor_temperature_c": Curve(((95.0, 60_000.0), (110.0, 6000.0)))},
    start="eco",
    modes={"eco": DriveMode(), "sport": DriveMode()},
)
STARTED_S = 1_700_000_000.0


class Scrape:
    """One reading of the metrics."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.families: dict[str, Metric] = {
            family.name: family for family in text_string_to_metric_families(text)
        }
        self.samples: dict[tuple[str, Labels], float] = {
            (sample.name, frozenset(sample.labels.items())): sample.value
            for family in self.families.values()
            for sample in family.samples
        }

    def value(self, name: str, **labels: str) -> float | None:
        """The sample of vcu_gateway_NAME with exactly these labels; None where it is absent."""
        return self.samples.get((f"vcu_gateway_{name}", frozenset(labels.items())))

    def by(self, name: str, label: str) -> dict[str, float]:
        """All samples of vcu_gateway_NAME by one of their labels."""
        found = self.of(f"vcu_gateway_{name}")
        return {dict(labels)[label]: value for labels, value in found.items()}

    def of(self, name: str) -> dict[Labels, float]:
        """All samples of this full name."""
        return {labels: value for (found, labels), value in self.samples.items() if found == name}

    @property
    def labels(self) -> dict[str, set[str]]:
        """The names of the labels of each sample name."""
        found: dict[str, set[str]] = {}
        for name, labels in self.samples:
            found.setdefault(name, set()).update(label for label, _ in labels)
        return found


class Program:
    """What `vcu-gateway run` puts together, without threads: the test ticks it.

    Attributes that break something:
        drive: the gateway among healthy nodes; api, facts: what the metrics are told.
        recorder, recorder_age_s: what the recorder told last, and when.
    """

    def __init__(self, drive: Drive | None = None, interface: Any = "virtual") -> None:
        self.drive = drive or Drive()
        settings = BusSettings(interface, "nowhere")
        self.connection = BusConnection(settings, (), self.drive.gateway.receive)
        self.loop = TickLoop(self.drive.gateway, self.connection, 50)
        self.api = ApiCounts(
            clients=0,
            accepted=0,
            turned_away=0,
            gave_way=0,
            stopped_anyway=0,
            requests=0,
            errors={},
            closed={},
            lost_updates=0,
        )
        self.facts = RunFacts("0123", CountedStart(2, 0), lambda: 0, self.drive.now_ns)
        self.facts.start_time_s = STARTED_S
        self.recorder: RecorderStatus | None = STATUS
        self.recorder_age_s = 0.5

    def tick(self, late_ns: int = 10_000) -> None:
        """One tick of simulated time, booked as the daemon does."""
        result = self.drive.tick()
        schedule = self.loop.schedule
        schedule.due(schedule.next_deadline_ns + late_ns)
        self.loop.silent_ticks += not result.frames
        self.connection.counters.sent += len(result.frames)
        self.loop.latest = LastTick.explained(self.drive.gateway, result, self.drive.now_ns)

    def run(self, duration_ms: int) -> "Program":
        """Tick for so long."""
        for _ in range(duration_ms // 50):
            self.tick()
        return self

    def reading(self) -> GatewayAnswers:
        """What the API answers now, through JSON."""
        now_ns, latest, config = self.drive.now_ns, self.loop.latest, Config()
        answers: dict[str, Any] = {}
        answers["health"] = health(self.loop, config, self.facts, self.api, now_ns)
        answers["config"] = {"digest": "", "values": configuration.effective(config)}
        if latest is not None:
            answers["state"] = views.state(self.drive.gateway, latest, now_ns)
            answers["why"] = views.why(latest.why)
            answers["tuning"] = views.tuning(self.drive.gateway, now_ns)
        answered = GatewayAnswers(**json.loads(json.dumps(answers, allow_nan=False)))
        return answered._replace(recorder=self.recorder, recorder_age_s=self.recorder_age_s)

    def scrape(self) -> Scrape:
        return Scrape(generate_latest(prometheus.registry(self.reading)).decode())


def driven() -> Program:
    """A program to which everything has happened: no family is without a sample."""
    drive = active(tuning=TUNED)
    drive.demanded = ControllerDemand(throttle_pct=30, power_mode=PowerMode.NORMAL)
    drive.codes = {"BMS_Status.CellOvervoltage": 1, "BMS_Temperatures.PackTemperature5": 255}
    drive.silent = {"IMU_Attitude"}
    program = Program(drive, "socketcan").run(2000)
    drive.codes |= {
        "ARD2_SteeringWheel.WheelSpeedFL": 30_000,
        "PCU1_Status1.MotorReverse": 1,
        "PCU1_Status1.MotorTemperature": 0,
        "PCU1_Status1.Throttle": 0,
        "PCU2_Status1.MotorTemperature": 90,
        "PCU2_Status1.Throttle": 0,
    }
    program.run(1200)
    drive.codes |= {"ARD2_SteeringWheel.WheelSpeedFL": 5_000, "PCU1_Status2.MotorSpeed": 3_000}
    program.run(200)
    drive.gateway.apply(calls.EmergencyStop())
    program.run(650)  # a status of each controller, while what went before is held
    drive.gateway.transmitter.gate.check(
        0,
        0,
        bytes(8),
        armed=False,
        demanded=None,
        speeds_rpm=(None, None),
        now_ns=drive.now_ns,
    )
    drive.gateway.receive(Frame(0x18FECA15, bytes(8), drive.now_ns))
    drive.gateway.receive(Frame(COMMAND_IDS["PCU2"] ^ 0xFF, bytes(8), drive.now_ns))
    program.connection.count_unsent("late")
    program.api |= {"clients": 2, "accepted": 5, "requests": 100}
    program.api |= {"errors": {"method_not_found": 1}, "closed": {"slow": 1}}
    program.tick()
    assert Effect.REGEN_LIMIT in drive.gateway.causes.effects()
    return program
