"""Results of the API's methods, as JSON has them.

Times end in `_ms` (age or duration) or `_ns` (CLOCK_MONOTONIC of this machine); None is JSON's
null and means unknown, never zero. The words under a field are its documentation: docs/api.md
and the OpenRPC document are made from this file.
"""

from typing import Any, Literal, NotRequired

from typing_extensions import TypedDict  # pydantic reads typing's own from 3.12 on only

ControllerName = Literal["PCU1", "PCU2"]
ModeName = Literal["starting", "standby", "active", "fault", "stopping"]
PowerModeName = Literal["eco", "normal", "turbo", "safety"]
QualityName = Literal["good", "out of range", "saturated", "stale", "never"]
EffectName = Literal[
    "alarm", "turbo off", "power limit", "regen limit", "regen off", "cap", "stop", "cut"
]
FaultClassName = Literal["driver", "service"]
StopStageName = Literal["latched", "sent", "on the bus", "cut", "not obeyed"]
LinkStateName = Literal["up", "error warning", "error passive", "bus off", "lost"]


class Signal(TypedDict):
    """One signal of a received message."""

    value: float | None
    """Physical value in `unit`; null before the first frame."""
    raw: int | None
    """The code on the wire; null before the first frame."""
    unit: str
    """Empty for enumerations and counts."""
    quality: QualityName
    """Quality of the value; only a good one may be relied upon."""
    name: NotRequired[str]
    """The code's name, for enumerations."""


class Message(TypedDict):
    """Latest frame of one received message."""

    frame_count: int
    """Frames since the start."""
    marked_count: int
    """Frames with a signal out of range or saturated."""
    age_ms: float | None
    """Since the kernel's arrival stamp; null before the first frame."""
    period_ms: float | None
    """Observed period, smoothed; null before the second frame."""
    stale: bool
    """Too old, or never received."""
    signals: dict[str, Signal]
    """By the protocol's signal names."""


class CarriedFrame(TypedDict):
    """A command frame that the kernel took, or that came back from the bus."""

    frame: str
    """Identifier and bytes as candump writes them."""
    age_ms: float


class ControllerCommand(TypedDict):
    """Command to one controller: the values are those that the last tick decided."""

    throttle_pct: float
    brake_pct: float
    power_mode: PowerModeName
    motor_reverse: bool
    regen_brake: bool
    power_cut: bool
    speed_limit_rpm: float
    power_limit_w: float
    decided: str | None
    """The frame with these values, as candump writes it; null while listening."""
    sent: CarriedFrame | None
    """The last one that the kernel took; null where nothing was sent."""
    echoed: CarriedFrame | None
    """The last one that came back because it had left; null where none did."""


class ControllerStopState(TypedDict):
    """What is known of a stop at one controller."""

    sent_ms: float | None
    """Since when the kernel takes frames with POWER_CUT; null where it does not."""
    echoed_ms: float | None
    """Since when they come back from the bus; null where they do not."""
    obeyed: bool | None
    """Whether the controller's own status says that it has cut; null where that is not known."""
    judged_ms: float | None
    """Age of that status."""
    power_cut: str | None
    """PowerCut in it, by its code's name."""
    throttle_pct: float | None
    """Throttle in it."""
    missing: str
    """What is not known to be so; empty where nothing is missing."""


class StopState(TypedDict):
    """What is known of the latched CUT, judged anew in every tick."""

    latched_ms: float
    """Since when it is latched."""
    reason: str
    stage: StopStageName
    sentence: str
    """The stop in one line, which claims no more than is known."""
    controllers: dict[ControllerName, ControllerStopState]


class DemandedValues(TypedDict):
    """Throttle and brake that the fresh demand asks of one controller."""

    throttle_pct: float
    brake_pct: float


class State(TypedDict):
    """Received messages, commands and stop, at one instant."""

    monotonic_ns: int
    """The instant, CLOCK_MONOTONIC of this machine."""
    mode: ModeName
    messages: dict[str, Message]
    """By the protocol's message names; only those that were asked for."""
    commands: dict[ControllerName, ControllerCommand]
    demanded: dict[ControllerName, DemandedValues]
    """Empty while no fresh demand counts."""
    stop: StopState | None
    """Null where no CUT is latched."""


class Cause(TypedDict):
    """One reason not to move, or to move less."""

    cause: str
    """Stable word for machines."""
    subject: str
    """Signal, message or part concerned."""
    detail: str
    """Its value, as a person reads it."""
    effect: EffectName
    since_ms: float
    """How long it has been in effect."""
    stands: bool
    """False where it is gone and only held for a while."""


class Latch(TypedDict):
    """A latched fault."""

    fault_class: FaultClassName
    """The level of the reset that it needs."""
    reason: str
    since_ms: float


class DemandState(TypedDict):
    """Demand in effect, or the last one that was."""

    source: str
    age_ms: float | None
    """Null for the bench demand, which does not age."""
    ttl_ms: int | None
    fresh: bool


class Why(TypedDict):
    """Explanation of why the vehicle does or does not move."""

    sentence: str
    """What matters most, in one line of at most 200 characters; the rest here is complete."""
    summary: NotRequired[str]
    """The first of it in plain words, at most 69 characters; an older gateway has none."""
    mode: ModeName
    latch: Latch | None
    blocks: list[Cause]
    """Causes that stop or cut."""
    limits: list[Cause]
    alarms: list[Cause]
    waits: list[str]
    """Conditions that are not met yet, as sentences."""
    demand: DemandState | None
    next_step: str
    """Action for the driver or operator."""


class DriveModeNow(TypedDict):
    """Drive mode of the vehicle."""

    current: str
    """The one whose pedal map, rise and power mode count."""
    requested: str
    """The one that was asked for last; another one waits for the pedal's release."""
    modes: list[str]
    left_by_service: list[str]
    """Those that only the service level leaves."""


class CurveNow(TypedDict):
    """A configured curve, and where the vehicle is on it."""

    key: str
    """Whole key in the configuration file."""
    input: str
    """Quantity that it is a curve over."""
    input_unit: str
    cap_unit: str
    points: list[list[float]]
    x: float | None
    """The input in the last tick; null where it is not known."""
    cap: float | None
    """The limit that it gives now, which returns slowly; null before the first tick."""
    limits: bool
    """Whether it gives less than its highest point."""


class PedalsNow(TypedDict):
    """Pedals on CAN, by their last frame that was a demand."""

    message: str
    throttle_pct: float | None
    """What the first track asks for; null where it is not known or came too long ago."""
    throttle_track2_pct: float | None
    """Null without a second track, too, as is the brake without one."""
    difference_pct: float | None
    brake_pct: float | None
    doubts: list[str]
    """Why they are not believed; none where they are."""
    sentence: str
    """All of it in a line."""


class TuningNow(TypedDict):
    """Drive mode, curves and slip limiter in the last tick, and the pedals now."""

    drive_mode: DriveModeNow | None
    """Null where there are no drive modes."""
    curves: list[CurveNow]
    slip_throttle_max_pct: dict[ControllerName, float] | None
    """Throttle that the slip limiter leaves each controller; null where it is off."""
    pedals: NotRequired[PedalsNow | None]
    """Null without pedals on CAN; an older gateway has none."""


class Link(TypedDict):
    """Bus interface."""

    interface: str
    channel: str
    state: LinkStateName
    since_ms: float
    lost: str | None
    """Reason why the interface cannot be used; null while it can."""


class LatenessBin(TypedDict):
    """Ticks with a lateness above the bound before and up to this one."""

    up_to_us: float | None
    """Null in the last bin, which is open."""
    ticks: int


class Ticks(TypedDict):
    """Figures of the 50 ms schedule."""

    period_ms: float
    done: int
    skipped: int
    silent: int
    """Ticks that sent nothing, listening before talking."""
    lateness_p50_us: float | None
    """Over the last `lateness_ticks` ticks; null before the first."""
    lateness_p90_us: float | None
    lateness_p99_us: float | None
    lateness_max_us: float | None
    lateness_ticks: int
    lateness_histogram: list[LatenessBin]
    """All ticks since the start, by rising bound."""


class FrameCounts(TypedDict):
    """Frame counters: every frame is in one of them."""

    received: int
    """Frames that the kernel handed over."""
    rejected: dict[str, int]
    """Not decoded, or no demand of the pedals, by reason."""
    out_of_order: int
    """Older than the one before them; judged, and not kept."""
    unjudged: int
    """Of which a late tick found more than it could judge."""
    dropped: int | None
    """By the kernel's receive buffer; null where that cannot be known."""
    sent: int
    unsent: dict[str, int]
    """Not sent, by reason."""
    confirmed: dict[ControllerName, int]
    """Own command frames that came back because they had left."""
    foreign_commands: dict[ControllerName, int]
    """Command frames of another sender; one to all counts for each controller."""
    blocked_by_gate: dict[str, int]
    """By the rule that they broke."""
    receiver_bugs: int


class ApiCounts(TypedDict):
    """Counters of the API."""

    clients: int
    """Connected now."""
    accepted: int
    turned_away: int
    """Connections beyond the limit on clients."""
    requests: int
    errors: dict[str, int]
    """Answers that were errors, by code."""
    closed: dict[str, int]
    """Connections that the gateway ended, by reason."""
    lost_updates: int
    """Notifications that a slow reader did not get."""
    gave_way: int
    """Idle connections that were ended because a new one needed their place."""
    stopped_anyway: int
    """Requests of estop and disarm that were wrong in form, and done all the same."""


class RecorderCounts(TypedDict):
    """What the gateway handed to the recorder, a datagram a tick."""

    connected: bool
    """A recorder listens now."""
    datagrams: int
    lost_datagrams: int
    """Datagrams that a connected recorder did not take in time."""
    lost_frames: int
    """Frames that were in them."""


class ProcessUsage(TypedDict):
    """Resources of the gateway's process, from /proc; null where the system does not report it."""

    cpu_time_s: float
    """User and system time of all threads, since the start."""
    resident_memory_bytes: int | None
    virtual_memory_bytes: int | None
    open_fds: int | None
    max_fds: int | None


class Versions(TypedDict):
    """Versions of the programs."""

    vcu_gateway: str
    python: str
    python_can: str
    kernel: str


class Health(TypedDict):
    """State of the gateway itself."""

    pid: int
    uptime_ms: float
    start_time_s: float
    """When it started, seconds since 1970 by the clock as it was then."""
    starts: int | None
    """Starts since the machine booted, this one included; null where they are not counted."""
    unexpected_restarts: int | None
    """Starts of this drive that no orderly end came before; three of them end arming."""
    config_file: str
    config_digest: str
    protocol_digest: str
    link: Link
    ticks: Ticks
    frames: FrameCounts
    api: ApiCounts
    recorder: RecorderCounts | None
    """Null where the configuration hands nothing on."""
    log_lines_dropped: int
    process: ProcessUsage
    versions: Versions


class EventEntry(TypedDict):
    """One kind of event with the same fields, however often it happened."""

    name: str
    severity: Literal["info", "warning", "error", "critical"]
    fields: dict[str, Any]
    count: int
    first_ms: float
    """Age of the first of them."""
    last_ms: float
    """Age of the last of them."""
    last_time: str
    """Wall clock of the last, ISO 8601, UTC."""


class Events(TypedDict):
    """Latest events, the newest last."""

    events: list[EventEntry]
    forgotten: int
    """Entries that made room for later ones."""


class Granted(TypedDict):
    """Granted request."""

    granted: Literal[True]
    mode: ModeName
    """The mode when it was granted; `why` says what follows."""
    waits_for_release: NotRequired[bool]
    """Only of `drive_mode.set`: the drive mode waits for the pedal's release; else it counts from
    the next tick on. As it was when it was granted; `tuning.get` says how it is."""


class Subscribed(TypedDict):
    """Subscription that began; `state.update` notifications follow."""

    subscription: int
    rate_hz: float


class Update(TypedDict):
    """Parameters of a `state.update` notification."""

    subscription: int
    lost: int
    """Updates not sent since the one before, because the reader was slow."""
    state: State


class ConfigInEffect(TypedDict):
    """Configuration in effect."""

    file: str
    digest: str
    values: dict[str, Any]
    """Every value by section and key."""


class Reloaded(TypedDict):
    """New configuration, now in effect."""

    changed: list[str]
    """Dotted names of what changed."""
    digest: str


class SignalDefinition(TypedDict):
    """One signal of the protocol."""

    name: str
    unit: str
    minimum: float
    maximum: float
    factor: float
    offset: float
    start_bit: int
    length_bits: int
    byte_order: Literal["little", "big"]
    signed: bool
    names: dict[str, str]
    """Name of each code, by the code as decimal text."""
    comment: str


class MessageDefinition(TypedDict):
    """One message of the protocol."""

    name: str
    can_id: str
    """29-bit identifier as 0x and 8 digits."""
    sender: str
    receivers: list[str]
    period_ms: int | None
    signals: list[SignalDefinition]
    comment: str


class Protocol(TypedDict):
    """Messages of the bus."""

    digest: str
    messages: list[MessageDefinition]
    aliases: dict[str, str]
    """Message name by further identifier."""
