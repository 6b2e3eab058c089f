"""`vcu-gateway pedals` on a joystick of the kernel (uinput), beside a gateway on a virtual bus."""

import grp
import importlib
import os
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.app.conftest import PATIENT
from tests.driven import Driven, armed, driven, wait_until
from tests.service.unit import NAME, systemctl
from tests.vcan.conftest import Process, Stand, ended_after, program
from vcu_gateway.client import Client, RefusedError
from vcu_gateway.errors import ConfigError
from vcu_gateway.pedals.sources import EvdevSource

# python3-evdev, in the guest's root.
evdev: Any = (
    importlib.import_module("evdev")
    if os.environ.get("VCU_REQUIRE_CONTROLLER")
    else pytest.importorskip("evdev")
)

ROOT = Path(__file__).parents[2]
BY_ID = Path("/dev/input/by-id/usb-Test_Wheel-event-joystick")
RULES = Path("/run/udev/rules.d/60-vcu-gateway-pedals.rules")
USER = "vcu-gateway-pedals"
UNIT = f"{USER}.service"
GATEWAY_FILE = Path("/etc/vcu-gateway/gateway.yaml")
PEDALS_FILE = Path("/etc/vcu-gateway/pedals.yaml")
CONFIG = f"""\
source: joystick
device: {{evdev: {BY_ID.name}}}
throttle: {{axis: ABS_Z, released: 255, pressed: 0}}
brake: {{axis: ABS_RZ, released: 255, pressed: 0}}
bench_use_only: true
"""
QUEUE_EVENTS = 64  # the least that the kernel keeps for a reader


class Wheel:
    """Joystick with two pedals; the link that udev makes for one on USB is made by hand."""

    def __init__(self) -> None:
        ecodes = evdev.ecodes
        axis = evdev.AbsInfo(value=255, min=0, max=255, fuzz=0, flat=0, resolution=0)
        axes = (ecodes.ABS_X, ecodes.ABS_Y, ecodes.ABS_Z, ecodes.ABS_RZ)
        events = {ecodes.EV_ABS: [(one, axis) for one in axes], ecodes.EV_KEY: [ecodes.BTN_TRIGGER]}
        self.device = evdev.UInput(events, name="Test Wheel")
        self.is_pulled = False
        self.node = Path(self.device.device.path)
        BY_ID.parent.mkdir(parents=True, exist_ok=True)
        BY_ID.unlink(missing_ok=True)
        BY_ID.symlink_to(self.node)
        subprocess.run(["udevadm", "settle"], check=True)

    def press(self, pct: float, axis: str = "ABS_Z") -> None:
        self.device.write(evdev.ecodes.EV_ABS, evdev.ecodes.ecodes[axis], round(255 - 2.55 * pct))
        self.device.syn()

    def pull(self) -> None:
        """Take the device away."""
        self.device.close()
        self.is_pulled = True


@pytest.fixture(scope="module", autouse=True)
def uinput() -> None:
    if not Path("/dev/uinput").exists():
        pytest.fail("no /dev/uinput: `lab run --qemu --modules uinput`")


class Bench:
    """The program, its wheel and a gateway; what a test has ended begins anew in the next one."""

    def __init__(self, stand: Stand, gateway: Driven) -> None:
        self.gateway, self._stand = gateway, stand
        self.client = gateway.client()
        self.wheel = Wheel()
        self._pedals: Process | None = None

    def start(self, name: str, *options: str) -> Process:
        socket = ("--socket", str(self.gateway.socket_path))
        return self._stand.start(name, *program(name, *options, *socket))

    def start_pedals(self) -> Process:
        """The program, which has said that it demands, or has ended."""
        file = self._stand.folder / "pedals.yaml"
        file.write_text(CONFIG)
        pedals = self._pedals = self.start("pedals", "-c", str(file))
        wait_until(lambda: "demanding as" in said(pedals) or has_ended(pedals), "the demand")
        return pedals

    def drive(self) -> Process:
        """Half of the travel is pressed, and throttle is on the bus."""
        if self.wheel.is_pulled:
            self.wheel = Wheel()
        if self._pedals is None or has_ended(self._pedals):
            self.start_pedals()
        self.wheel.press(0, "ABS_RZ")
        if self.gateway.mode != "active":
            self.wheel.press(0)
            self.gateway.until_ready()
            self.gateway.until(lambda: armed(self.client), "arm")
        self.wheel.press(50)
        self.gateway.throttles()
        self.gateway.until(lambda: any(self.gateway.throttles()), "throttle")
        assert self._pedals is not None
        return self._pedals

    def end_pedals(self) -> None:
        if self._pedals is not None:
            self._pedals.stop()
        if self.wheel.is_pulled:
            self.wheel = Wheel()
        self.gateway.until_ready()

    def close(self) -> None:
        self.client.close()
        self.wheel.pull()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("pedals")
    with driven(folder, always=PATIENT) as gateway, ended_after(Stand(folder)) as stand:
        gateway.until_ready()
        one = Bench(stand, gateway)
        yield one
        one.close()


@pytest.fixture
def pedals(bench: Bench) -> Process:
    return bench.drive()


def has_ended(process: Process) -> bool:
    return process.popen.poll() is not None


def said(process: Process) -> str:
    return process.err.read_text()


def stamped_throttles(gateway: Driven) -> Iterator[tuple[float, int]]:
    """Stamp and throttle code of every command heard since the last call."""
    while frame := gateway.other_node.recv(0):
        if frame.arbitration_id in gateway.nodes.command_ids:
            yield frame.timestamp, frame.data[1]


def demanded(client: Client) -> dict[str, Any]:
    return dict(client.state()["demanded"].get("PCU1", {}))


def pct(value: float) -> Any:
    return pytest.approx(value, abs=0.5)


def test_a_pedal_pressed_and_released_is_demanded_as_such(bench, pedals):
    assert "bench use only, wheels off the ground" in said(pedals)
    for travel_pct in (50, 100, 20, 0):
        until_demanded(bench, travel_pct)
    bench.gateway.until(lambda: bench.gateway.throttles() == {0}, "commands without throttle")
    bench.wheel.press(30, "ABS_RZ")
    bench.gateway.until(lambda: demanded(bench.client)["brake_pct"] == pct(28.7), "the brake")
    assert bench.client.why()["demand"]["source"] == "joystick"


def test_events_that_the_kernel_drops_leave_no_pedal_stuck(bench, pedals):
    ecodes = evdev.ecodes
    bench.wheel.press(30, "ABS_RZ")
    bench.gateway.until(lambda: demanded(bench.client)["brake_pct"] == pct(28.7), "the brake")
    other = evdev.InputDevice(str(bench.wheel.node))
    bench.wheel.press(0, "ABS_RZ")
    for number in range(3 * QUEUE_EVENTS):
        bench.wheel.press(100 if number % 2 else 40)
    until_demanded(bench, 0)
    bench.gateway.until(lambda: demanded(bench.client)["brake_pct"] == 0, "the released brake")
    found = [(event.type, event.code) for event in other.read()]
    assert (ecodes.EV_SYN, ecodes.SYN_DROPPED) in found, "a reader of events has lost some"
    other.close()
    until_demanded(bench, 50)
    assert not has_ended(pedals)


def test_a_second_program_is_refused_while_the_pedals_own_the_demand(bench, pedals):
    second = bench.start("demand", "--source", "second", "--throttle", "10")
    assert second.popen.wait(60) == 75
    assert "joystick owns the demand" in said(second)
    assert not has_ended(pedals)
    assert bench.client.why()["demand"]["source"] == "joystick"
    assert any(bench.gateway.throttles())


def test_what_it_costs_at_50_reads_a_second(bench, pedals, figures):
    def spent_s() -> float:
        fields = Path(f"/proc/{pedals.popen.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def requests() -> int:
        return bench.client.health()["api"]["requests"]

    spent, asked, begun_s = spent_s(), requests(), time.monotonic()
    time.sleep(5)  # a tick of the kernel's count of processor time is 10 ms
    took_s = time.monotonic() - begun_s
    share_pct = 100 * (spent_s() - spent) / took_s
    demands_s = (requests() - asked) / took_s
    figures.append(f"pedals: {demands_s:.1f} demands a second, {share_pct:.1f} % of a processor")
    assert demands_s == pytest.approx(50, abs=2.5)


def test_a_device_that_is_pulled_while_pressed_leaves_no_throttle(bench, pedals, figures):
    gateway, throttles = bench.gateway, list[tuple[float, int]]()
    time.sleep(0.3)  # some commands with throttle, which are looked for below
    pulled_s = time.time()
    bench.wheel.pull()

    def has_no_throttle() -> bool:
        throttles.extend(stamped_throttles(gateway))
        return [raw for _, raw in throttles[-4:]] == [0, 0, 0, 0]

    gateway.until(has_no_throttle, "commands without throttle")
    gateway.until_mode("standby")
    assert any(raw for stamp_s, raw in throttles if stamp_s < pulled_s), "pressed until then"
    first_s = next(stamp_s for stamp_s, raw in throttles if stamp_s > pulled_s and not raw)
    took_ms = (first_s - pulled_s) * 1000
    figures.append(f"joystick pulled while pressed: throttle 0 on the bus after {took_ms:.0f} ms")
    assert pedals.popen.wait(30) == 69
    assert f"the pedals end: {BY_ID} cannot be read: [Errno 19] No such device" in said(pedals)
    assert took_ms < 200, "faster than the demand's time to live"


def test_a_pedal_that_is_pressed_at_the_start_is_known_without_any_event(bench):
    bench.end_pedals()
    bench.wheel.press(60)
    bench.start_pedals()
    bench.gateway.until(lambda: demanded(bench.client)["throttle_pct"] == pct(60.6), "the pedal")
    with pytest.raises(RefusedError, match="throttle"):
        bench.client.arm()


def test_pedals_are_refused_while_a_second_program_owns_the_demand(bench):
    bench.end_pedals()
    with bench.client.demand("second"):
        pedals = bench.start_pedals()
        assert pedals.popen.wait(30) == 75
    assert (
        "refused: second owns the demand; another program demands: end it, or see demand.priorities"
        in said(pedals)
    )


def test_an_axis_that_the_device_has_not_is_said_with_those_that_it_has(bench):
    with pytest.raises(ConfigError) as refused:
        EvdevSource(bench.wheel.node, {"throttle": "ABS_Z", "brake": "ABS_RX"})
    assert str(refused.value) == (
        f"{bench.wheel.node} has no axis ABS_RX; it has ABS_RZ, ABS_X, ABS_Y, ABS_Z"
    )


def test_the_rule_of_udev_lets_the_units_user_read_a_joystick_and_no_keyboard():
    subprocess.run(["systemd-sysusers", ROOT / "systemd/sysusers.conf"], check=True)
    RULES.parent.mkdir(parents=True, exist_ok=True)
    RULES.write_text((ROOT / "systemd" / RULES.name).read_text())
    subprocess.run(["udevadm", "control", "--reload"], check=True)
    wheel, keyboard = Wheel(), evdev.UInput(name="Test Keyboard")
    subprocess.run(["udevadm", "settle"], check=True)
    try:
        assert access(wheel.node) == (USER, 0o640)
        assert access(Path(keyboard.device.path)) != (USER, 0o640)
        config = Path("/run/pedals.yaml")
        config.write_text(CONFIG)
        shown = subprocess.Popen(
            [*program("pedals", "--show"), "-c", config],
            stdout=subprocess.PIPE, text=True, user=USER, group=USER, extra_groups=[], cwd="/",
        )  # fmt: skip
        assert shown.stdout is not None
        lines = [shown.stdout.readline() for _ in range(2)]
        shown.terminate()
        assert shown.wait(60) == 0
    finally:
        wheel.device.close()
        keyboard.close()
        RULES.unlink()
    assert re.match(r"throttle +255  \[\.{20}\]    0 %  seen 255 to 255\n", lines[0]), lines
    assert lines[1].startswith("brake ")


def test_the_packaged_unit_reads_a_joystick_and_starts_again_when_it_is_back():
    """As the package brings it: unit, rule and user."""
    if not Path("/lib/systemd/system", UNIT).exists():
        pytest.fail("the package is not installed: `lab run --install build/deb/*.deb`")
    wheel, before = Wheel(), GATEWAY_FILE.read_text()
    GATEWAY_FILE.write_text(f"api: {{operator_users: [{USER}]}}\n")
    PEDALS_FILE.write_text(CONFIG)

    def until_throttle(travel_pct: float) -> None:
        wheel.press(travel_pct)
        wait_until(lambda: throttle_is(client, travel_pct), "the demand", 60)

    try:
        assert systemctl("restart", NAME).returncode == 0
        assert systemctl("start", UNIT).returncode == 0
        with Client() as client:
            until_throttle(40)
            wheel.pull()
            wait_until(lambda: "cannot be read: [Errno 19]" in journal(), "the end")
            wait_until(lambda: not demanded(client), "the release")
            wheel = Wheel()
            until_throttle(70)
    finally:
        print(journal())
        systemctl("stop", UNIT, NAME)
        wheel.pull()
        PEDALS_FILE.unlink()
        GATEWAY_FILE.write_text(before)


def until_demanded(bench: Bench, travel_pct: float) -> None:
    bench.wheel.press(travel_pct)
    bench.gateway.until(lambda: throttle_is(bench.client, travel_pct), f"{travel_pct} %")


def throttle_is(client: Client, travel_pct: float) -> bool:
    asked_pct = min(100, max(0, (travel_pct - 3) / 0.94))
    return demanded(client).get("throttle_pct") == pct(asked_pct)


def journal() -> str:
    command = ["journalctl", "--unit", UNIT, "--no-pager", "--output", "cat", "--lines=30"]
    return subprocess.run(command, capture_output=True, text=True).stdout


def access(node: Path) -> tuple[str, int]:
    """Group and mode."""
    found = node.stat()
    return grp.getgrgid(found.st_gid).gr_name, found.st_mode & 0o777
