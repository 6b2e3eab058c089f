"""Golden drives of the bus: odd frames, other senders, errors, and a link that goes."""

from random import Random

from tests.core.simulated_drive import CODEC, RECEIVED
from tests.golden.scripted_drive import MS, ScriptedDrive
from tests.golden.scripts import golden
from vcu_gateway.core import calls
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.supervisor import Mode

PCU1_COMMAND, PCU2_COMMAND = 0x0008A7D0, 0x0008A8D0
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")
CONTROLLER, BUS_OFF, RESTARTED = 0x004, 0x040, 0x100
WARNING, PASSIVE, ACTIVE = 0x08, 0x20, 0x40


@golden(3, 4, 6, 7, 8, 10)
def odd_frames(drive: ScriptedDrive) -> None:
    """Remote, standard, error and unknown frames; other priorities and other sources."""
    drive.start_driving()
    for name in RECEIVED:
        can_id = CODEC.by_name[name].spec.can_id
        drive.receive(can_id, b"", remote=True)
        drive.receive(can_id & 0x7FF, bytes(8), extended=False)
        drive.receive(can_id ^ 0x55, bytes(8))
        drive.ticks(1)
    for priority in range(8):
        drive.say("BMS_Temperatures")
        drive.receive(0x0009D0F4 | priority << 26, bytes.fromhex("4141414141000000"))
        drive.ticks(1)
    for classes in (0x004, 0x040 & 0, 0x080, 0x200):
        drive.error_frame(classes)
        drive.ticks(1)
    chance = Random(10)
    for _ in range(300):
        drive.receive(chance.getrandbits(29) | 0x0FF0000, chance.randbytes(8))
        drive.receive(chance.getrandbits(11), chance.randbytes(8), extended=False)
    drive.run(500)
    drive.receive(PCU1_COMMAND, b"", remote=True)
    drive.run(500)


@golden(31)
def order(drive: ScriptedDrive) -> None:
    """Every frame twice; then frames that come after younger ones of their message."""
    drive.start_driving()
    with drive.broken({"fault": "duplicate"}):
        drive.run(2500)
    drive.start_driving()
    chance = Random(31)
    for _ in range(40):
        name = chance.choice(RECEIVED)
        drive.say(name, at_ns=drive.now_ns - chance.randrange(1, 900) * MS)
        drive.ticks(1)
    for _ in range(3):
        drive.say("BMS_Status", at_ns=drive.now_ns + 5 * MS)
        drive.ticks(2)


@golden(32)
def loss(drive: ScriptedDrive) -> None:
    """A third of all frames is lost."""
    drive.start_driving()
    with drive.broken({"fault": "drop", "share_pct": 30}):
        drive.run(6000)


@golden(33)
def corruption(drive: ScriptedDrive) -> None:
    """Every frame has a wrong bit, then eight."""
    for flip_bits in (1, 8):
        drive.start_driving()
        with drive.broken({"fault": "corrupt", "flip_bits": flip_bits, "seed": flip_bits}):
            drive.run(2000)
        drive.run(1200)


@golden(34)
def flood(drive: ScriptedDrive) -> None:
    """Foreign frames of the highest priority, 2,000 a second, that no filter keeps away."""
    drive.start_driving()
    for number in range(1000):
        drive.wait_until(drive.now_ns + MS // 2)
        drive.receive(number % 16, bytes(8))
        if drive.tick_ns <= drive.now_ns + MS:
            drive.tick()


@golden(35, 50, 54, 57, 59)
def late_ticks(drive: ScriptedDrive) -> None:
    """Ticks that are 1, 2, 4, 5 and 40 periods late, to the nanosecond; one that is early."""
    for late_ns in (
        1,
        50 * MS,
        100 * MS,
        200 * MS - 1,
        200 * MS,
        200 * MS + 1,
        250 * MS,
        2000 * MS,
    ):
        drive.start_driving()
        drive.tick(late_ns)
        drive.run(600)
        drive.run(1200)
    drive.start_driving()
    drive.wait_until(drive.tick_ns - 20 * MS)
    drive.tick_now()
    drive.run(500)
    drive.demanded = None
    drive.tick(210 * MS)
    drive.run(300)
    drive.start_driving()
    drive.wait_until(drive.tick_ns + 210 * MS)
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.tick_ns = drive.now_ns + MS
    drive.run(300)


@golden(56)
def suspended(drive: ScriptedDrive) -> None:
    """Minutes, then a day, between two ticks."""
    drive.start_driving()
    for minutes in (3, 1440):
        drive.connected = False
        drive.now_ns += minutes * 60_000 * MS
        drive.connected = True
        drive.tick_ns = drive.now_ns + MS
        drive.run(400)
        drive.run(1500)
        drive.start_driving()


@golden(36, 37, 48, 77)
def error_frames(drive: ScriptedDrive) -> None:
    """Error-warning; error-passive for a second, a little more, and in pieces; a flood of both."""
    drive.start_driving()
    drive.error_frame(CONTROLLER, WARNING)
    drive.run(500)
    drive.error_frame(CONTROLLER, ACTIVE)
    drive.run(200)
    for passive_ms in (990, 1000, 1050, 1100):
        drive.error_frame(CONTROLLER, PASSIVE)
        drive.run(passive_ms)
        drive.error_frame(CONTROLLER, ACTIVE)
        drive.run(6500)
        drive.start_driving()
    for _ in range(6):
        drive.error_frame(CONTROLLER, PASSIVE)
        drive.run(200)
        drive.error_frame(CONTROLLER, WARNING)
        drive.run(250)
    drive.error_frame(CONTROLLER, ACTIVE)
    for _ in range(200):
        drive.error_frame(0x080)
        drive.wait_until(drive.now_ns + MS // 10)
    drive.run(300)


@golden(38, 39, 77)
def bus_off(drive: ScriptedDrive) -> None:
    """Bus-off by error frame, by carrier, within a tick, and ten times a second."""
    drive.start_driving()
    drive.error_frame(BUS_OFF)
    drive.accepted = drive.connected = False
    drive.run(700)
    drive.error_frame(RESTARTED)
    drive.accepted = drive.connected = True
    drive.run(2500)
    drive.start_driving()
    drive.error_frame(BUS_OFF)
    drive.wait_until(drive.now_ns + 10 * MS)
    drive.error_frame(RESTARTED)
    drive.run(1500)
    drive.start_driving()
    drive.carry(False)
    drive.run(500)
    drive.carry(True)
    drive.run(1500)
    drive.start_driving()
    for _ in range(10):
        drive.error_frame(BUS_OFF)
        drive.wait_until(drive.now_ns + 40 * MS)
        drive.error_frame(CONTROLLER, ACTIVE)
        drive.run(60)
    drive.run(1500)
    drive.error_frame(BUS_OFF)
    drive.run(200)
    drive.carry(True)
    drive.run(1500)


@golden(40, 42)
def refused(drive: ScriptedDrive) -> None:
    """The bus takes no frame for one, two, three ticks and longer; then it takes them again."""
    for ticks in (1, 2, 3, 4, 12):
        drive.start_driving()
        drive.accepted = False
        drive.ticks(ticks)
        drive.accepted = True
        drive.run(1800)


@golden(40)
def refused_on_the_ramp(drive: ScriptedDrive) -> None:
    """The bus takes no frame for a tick while the throttle rises: it rises from what was sent."""
    drive.start_driving(throttle_pct=0)
    drive.demand(throttle_pct=80)
    drive.ticks(3)
    drive.accepted = False
    drive.ticks(1)
    drive.accepted = True
    drive.run(600)


@golden(41)
def unconfirmed(drive: ScriptedDrive) -> None:
    """Frames are taken and do not come back, for 2, 3, 4 ticks and for 5 s."""
    for ticks in (2, 3, 4, 100):
        drive.start_driving()
        drive.echo = False
        drive.ticks(ticks)
        drive.echo = True
        drive.run(1800)


@golden(43, 44)
def no_interface(drive: ScriptedDrive) -> None:
    """The interface is missing, then down, at the start; it opens later."""
    drive.lose_link()
    drive.run(1500)
    drive.open_link(carrier=True)
    drive.run(900)
    drive.open_link(LinkState.WARNING)
    drive.run(1500)
    drive.arm()
    drive.start_driving()


@golden(45, 46, 47)
def lost_link(drive: ScriptedDrive) -> None:
    """The link is lost and opened again while driving, in standby and in a fault."""
    for lost_ms in (20, 300, 2500):
        drive.start_driving()
        drive.lose_link()
        drive.run(lost_ms)
        drive.open_link()
        drive.run(300)
        drive.reset()
        drive.run(1500)
        drive.start_driving()
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(200)
    drive.open_link(carrier=False)
    drive.run(400)
    drive.carry(True)
    drive.run(2500)


@golden(73, 74, 75, 76)
def another_sender(drive: ScriptedDrive) -> None:
    """Another sender while listening, while driving, to one, to all, and from other addresses."""
    drive.run(700)
    drive.receive(PCU1_COMMAND, ZERO_TORQUE)
    drive.run(900)
    drive.receive(PCU2_COMMAND, ZERO_TORQUE)
    drive.run(2500)
    for can_id in (PCU1_COMMAND, PCU2_COMMAND, 0x0008FFD0, 0x0008A7D1, 0x1C08A8D0):
        drive.start_driving()
        drive.receive(can_id, ZERO_TORQUE)
        drive.run(400)
        drive.reset()
        drive.run(1800)
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(200)
    drive.receive(PCU1_COMMAND, bytes(3))
    drive.run(1500)
    drive.until(Mode.FAULT)


@golden(78)
def random_frames(drive: ScriptedDrive) -> None:
    """Random payloads in every message, random identifiers, every length."""
    chance = Random(78)
    for _ in range(6):
        drive.start_driving()
        for _ in range(12):
            can_id = CODEC.by_name[chance.choice(RECEIVED)].spec.can_id
            drive.receive(can_id, chance.randbytes(8))
            drive.receive(chance.getrandbits(29) | 0x0FF0000, chance.randbytes(chance.randrange(9)))
            drive.ticks(2)
        drive.run(1300)
