"""A gateway program in simulated time, and its metrics as Prometheus would read them."""

from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families

from tests.core.safety_world import COMMAND_IDS, Drive, active
from vcu_gateway import exporter
from vcu_gateway.api.results import ApiCounts
from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.frame import Frame
from vcu_gateway.daemon.loop import LastTick, TickLoop

Labels = frozenset[tuple[str, str]]
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

    Attributes to break the world with:
        drive: the gateway among healthy nodes; api, facts: what the metrics are told.
    """

    def __init__(self, drive: Drive | None = None, interface: str = "virtual") -> None:
        self.drive = drive or Drive()
        settings = BusSettings(interface, "nowhere")
        self.door = BusConnection(settings, (), self.drive.gateway.intake.receive)
        self.daemon = TickLoop(self.drive.gateway, self.door, 50)
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
        self.facts = exporter.Facts(
            version="1.2.3",
            python="3.11.0",
            protocol_digest="0123",
            config_digest=lambda: "4567",
            started_ns=self.drive.now_ns,
            started_s=STARTED_S,
            starts=2,
            log_lines_dropped=lambda: 0,
        )

    def tick(self, late_ns: int = 10_000) -> None:
        """One tick of simulated time, booked as the daemon does."""
        result = self.drive.tick()
        schedule = self.daemon.schedule
        schedule.due(schedule.next_deadline_ns + late_ns)
        self.daemon.silent_ticks += not result.frames
        self.door.counters.sent += len(result.frames)
        self.daemon.latest = LastTick(result, self.drive.gateway.why(self.drive.now_ns))

    def run(self, duration_ms: int) -> "Program":
        """Tick for so long."""
        for _ in range(duration_ms // 50):
            self.tick()
        return self

    def exposition(self):
        return exporter.exposition(
            self.daemon, lambda: self.api, self.facts, lambda: self.drive.now_ns
        )

    def scrape(self) -> Scrape:
        return Scrape(self.exposition().text().decode())


def driven() -> Program:
    """A program to which everything has happened: no family is without a sample."""
    drive = active()
    drive.asked = ControllerDemand(throttle_pct=30, power_mode=PowerMode.NORMAL)
    drive.codes = {"BMS_Status.CellOvervoltage": 1, "BMS_Temperatures.PackTemperature5": 255}
    drive.silent = {"IMU_Attitude"}
    program = Program(drive, "socketcan").run(2000)
    drive.codes |= {
        "ARD2_SteeringWheel.WheelSpeedFL": 30_000,
        "PCU1_Status1.MotorReverse": 1,
        "PCU1_Status1.Throttle": 0,
        "PCU2_Status1.Throttle": 0,
    }
    program.run(1200)
    drive.codes |= {"ARD2_SteeringWheel.WheelSpeedFL": 5_000, "PCU1_Status2.MotorSpeed": 3_000}
    program.run(200)
    drive.gateway.output.gate.check(
        0, 0, bytes(8), armed=False, speeds_rpm=(None, None), now_ns=drive.now_ns
    )
    drive.gateway.intake.receive(Frame(0x18FECA15, bytes(8), drive.now_ns))
    drive.gateway.intake.receive(Frame(COMMAND_IDS["PCU2"] ^ 0xFF, bytes(8), drive.now_ns))
    program.door.withhold("late")
    program.api |= {"clients": 2, "accepted": 5, "requests": 100}
    program.api |= {"errors": {"method_not_found": 1}, "closed": {"slow": 1}}
    program.tick()
    assert Effect.REGEN_LIMIT in drive.gateway.causes.effects()
    return program
