"""Pedals on CAN in the configuration file: what is taken, and each refusal."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.core.pedal_node import CODEC, PEDALS, POSITION
from vcu_gateway.config import (
    Config,
    check_against,
    check_effect,
    core_settings,
    parse,
    schema,
    yaml_text,
)
from vcu_gateway.config.checks import startable
from vcu_gateway.core.can_pedals import PedalReader
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.core.settings import RESTART_ONLY, changed
from vcu_gateway.daemon import reload
from vcu_gateway.errors import ConfigError
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.recording.call_text import settings_json, settings_of

LINES = {
    "message": "Pedals_Position",
    "throttle": "{signal: Throttle1, released: 0.625, pressed: 3.75}",
    "throttle_track2": "{signal: Throttle2, released: 0.3125, pressed: 1.875}",
    "brake": "{signal: BrakePressure, released: 0.5, pressed: 60.5}",
    "counter": "Counter",
    "checksum": "{signal: Checksum, kind: xor}",
    "reverse": "ReverseSwitch",
}
PROTOCOL = CODEC.protocol


def file_of(**lines):
    """A file with these lines beside the whole ones, a key in each; None leaves one out."""
    given = {key: line for key, line in (LINES | lines).items() if line is not None}
    return "pedals:\n  can:\n" + "".join(f"    {key}: {line}\n" for key, line in given.items())


def refusals(text, protocol=PROTOCOL):
    """What a start says of this file, without its name and lines."""
    try:
        config = parse(text, "f")
    except ConfigError as error:
        found = list(error.problems)
    else:
        found = check_against(config, protocol)
    return [str(problem).split(": ", 1)[1] for problem in found]


def with_signal(name, **changes):
    """The protocol with another layout of one signal."""
    signals = [replace(one, **changes) if one.name == name else one for one in POSITION.signals]
    return with_message(signals=tuple(signals))


def with_message(**changes):
    message = replace(POSITION, **changes)
    others = [one for one in PROTOCOL.messages if one.name != POSITION.name]
    return replace(PROTOCOL, messages=(*others, message))


def test_the_whole_section_reaches_the_core():
    config = parse(file_of(), "f")
    assert core_settings(config).pedals == PEDALS
    assert check_against(config, PROTOCOL) == []
    assert check_effect(config) == []


def test_what_may_be_chosen_reaches_the_core():
    chosen = file_of(
        power_mode="turbo",
        regen_brake="true",
        dead_zone_pct=10,
        coast_brake_pct="[[0, 15], [5, 0]]",
    )
    pedals = core_settings(parse(chosen, "f")).pedals
    assert (pedals.power_mode, pedals.regen_brake) == (PowerMode.TURBO, True)
    assert (pedals.dead_zone_pct, pedals.coast_brake) == (10, Curve(((0, 15), (5, 0))))


def test_without_the_key_there_are_no_pedals():
    assert core_settings(Config()).pedals is None
    assert core_settings(parse("pedals: {can: null}", "f")).pedals is None
    assert "pedals" not in settings_json(core_settings(Config()))
    assert "pedals" not in yaml_text(Config())


def test_the_section_comes_back_from_text_and_recording():
    config = parse(file_of(coast_brake_pct="[[0, 15], [5, 0]]"), "f")
    settings = core_settings(config)
    assert core_settings(parse(yaml_text(config), "f")) == settings
    assert settings_of(json.loads(json.dumps(settings_json(settings)))) == settings


@pytest.mark.parametrize("pedals", [5, {}, {"message": "P"}, {"throttle": 5}, {"colour": 1}])
def test_recorded_pedals_that_are_none_are_refused(pedals):
    with pytest.raises(ValueError, match="the pedals cannot be read"):
        settings_of({"pedals": pedals})


EXAMPLES = Path(__file__).parents[2] / "config" / "examples"


@pytest.mark.parametrize(
    ("name", "message", "told"),
    [
        ("pedals", "Pedals_Position", []),
        (
            "pedals-eec2",
            "EEC2",
            [
                "pedals.can: has no brake: brake over throttle is not watched",
                "pedals.can: has no counter: a node that repeats its last frame is believed",
                (
                    "pedals.can.throttle_track2: has the ends of throttle: only the node can see a"
                    " short between them"
                ),
            ],
        ),
    ],
)
def test_an_example_starts_with_its_own_dbc_the_packaged_one_and_a_message(name, message, told):
    config, protocol = startable(EXAMPLES / f"{name}.yaml", on_this_machine=False)
    names = [one.name for one in protocol.messages]
    assert names == [*(one.name for one in dbc.load(packaged("vcu.dbc")).messages), message]
    assert core_settings(config).pedals.message == message
    assert [problem.what for problem in check_effect(config)] == told


def test_the_error_codes_of_eec2_are_not_known():
    config, protocol = startable(EXAMPLES / "pedals-eec2.yaml", on_this_machine=False)
    reader = PedalReader(core_settings(config).pedals, Codec(protocol).by_name["EEC2"])
    for raw, doubted in ((0, False), (250, False), (251, True), (0xFE, True), (0xFF, True)):
        reading = reader.read(reader.decode(bytes([0, raw, 0, 0, 125, 0, 0, 0])))
        assert ("AccelPedalPos1" in reading.doubts) is doubted
    assert reading.track2_pct == 50


CAN = "pedals.can."
WRONG = [
    (
        {"message": "Pedals_Positon"},
        (
            'message: the gateway receives no message "Pedals_Positon"; did you mean'
            ' "Pedals_Position"?'
        ),
    ),
    (
        {"throttle": "{signal: Throtle1, released: 0.625, pressed: 3.75}"},
        'throttle.signal: Pedals_Position has no signal "Throtle1"; did you mean "Throttle1"?',
    ),
    (
        {"counter": "Nothing"},
        (
            'counter: Pedals_Position has no signal "Nothing"; its signals are Throttle1,'
            " Throttle2, BrakePressure, ReverseSwitch, Counter, Checksum"
        ),
    ),
    (
        {"throttle_track2": None},
        (
            "throttle_track2: is missing; one track is for a bench alone:"
            " single_track_bench_use_only: true"
        ),
    ),
    (
        {"brake": "{signal: BrakePressure, released: 3, pressed: 3}"},
        "brake.pressed: must differ from released, 3; measure both ends of the travel",
    ),
    (
        {"brake": "{signal: Throttle1, released: 1, pressed: 3}"},
        "brake.signal: Throttle1 is throttle already; each needs a signal of its own",
    ),
    (
        {"reverse": "Checksum"},
        ("reverse: Checksum is checksum already; each needs a signal of its own"),
    ),
    (
        {"throttle": "{signal: Throttle1, released: 0.625, pressed: 5.001}"},
        "throttle.pressed: must be 0 to 5 V, as the signal, not 5.001",
    ),
    (
        {"brake": "{signal: BrakePressure, released: -0.1, pressed: 100}"},
        "brake.released: must be 0 to 100 bar, as the signal, not -0.1",
    ),
    (
        {"throttle_track2": "{signal: Throttle2, released: 0.625, pressed: 3.75}"},
        (
            "throttle_track2: must have another gradient or offset than throttle; a short between"
            " them would look like two tracks that agree"
        ),
    ),
    ({"dead_zone_pct": "10.1"}, "dead_zone_pct: must be at most 10 %, not 10.1"),
    ({"dead_zone_pct": "-0.1"}, "dead_zone_pct: must be at least 0 %, not -0.1"),
    ({"power_mode": "safety"}, 'power_mode: must be one of eco, normal, turbo, not "safety"'),
    (
        {"checksum": "{signal: Checksum, kind: crc32}"},
        ('checksum.kind: must be one of xor, sum, sae_j1850, not "crc32"'),
    ),
    (
        {"coast_brake_pct": "[[0, 15], [6, 0]]"},
        "coast_brake_pct[2]: x must be 0 to 5 %, not 6",
    ),
    (
        {"coast_brake_pct": "[[0, 31], [5, 0]]"},
        "coast_brake_pct[1]: y must be 0 to 30 %, not 31",
    ),
    (
        {"coast_brake_pct": "[[0, 5], [3, 6], [5, 0]]"},
        "coast_brake_pct[2]: must not rise with the pedal: 6 % after 5 %",
    ),
    (
        {"coast_brake_pct": "[[0, 15], [5, 1]]"},
        (
            "coast_brake_pct[2]: the last point must be at a brake of 0 %; a pedal that is pressed"
            " does not coast"
        ),
    ),
    (
        {"single_track_bench_use_only": "false"},
        (
            "single_track_bench_use_only: must be true, not false; it confirms that the wheels are"
            " off the ground"
        ),
    ),
]


@pytest.mark.parametrize(("lines", "text"), WRONG, ids=lambda one: str(one)[:40])
def test_wrong_pedals_are_refused_with_the_place_and_what_to_do(lines, text):
    assert refusals(file_of(**lines)) == [CAN + text]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"period_ms": None}, "has no period"),
        ({"period_ms": 9}, "comes every 9 ms"),
        ({"period_ms": 51}, "comes every 51 ms"),
    ],
)
def test_the_message_comes_every_10_to_50_ms(changes, text):
    assert refusals(file_of(), with_message(**changes)) == [
        f"{CAN}message: Pedals_Position {text}; a message of pedals comes every 10 to 50 ms"
    ]
    for period_ms in (10, 50):
        assert refusals(file_of(), with_message(period_ms=period_ms)) == []


def test_the_message_is_one_that_the_gateway_receives():
    (refusal,) = refusals(file_of(), with_message(receivers=("BMS",)))
    assert refusal.startswith(f'{CAN}message: the gateway receives no message "Pedals_Position"')


@pytest.mark.parametrize(("period_ms", "least_ms"), [(10, 110), (20, 110), (50, 200)])
def test_a_demand_may_live_as_long_as_it_counts(period_ms, least_ms):
    protocol = with_message(period_ms=period_ms)
    for ttl_ms, taken in ((least_ms, True), (least_ms - 1, False)):
        found = refusals(file_of() + f"demand: {{ttl_max_ms: {ttl_ms}}}\n", protocol)
        assert (found == []) is taken
    assert found == [
        (
            f"demand.ttl_max_ms: must be at least {least_ms} ms, not {least_ms - 1}; a demand of"
            " Pedals_Position counts so long"
        )
    ]


@pytest.mark.parametrize("changes", [{"signed": True}, {"factor": 2.0}, {"offset": 1.0}])
@pytest.mark.parametrize(("key", "signal"), [("counter", "Counter"), ("reverse", "ReverseSwitch")])
def test_counter_and_switch_are_plain_codes(key, signal, changes):
    assert refusals(file_of(), with_signal(signal, **changes)) == [
        f"{CAN}{key}: {signal} must be unsigned, with factor 1 and offset 0"
    ]


@pytest.mark.parametrize(
    "changes", [{"length_bits": 7}, {"start_bit": 52}, {"signed": True}, {"factor": 2.0}]
)
def test_a_checksum_is_a_whole_byte(changes):
    assert refusals(file_of(), with_signal("Checksum", **changes)) == [
        f"{CAN}checksum.signal: Checksum must be one whole byte, with factor 1 and offset 0"
    ]


@pytest.mark.parametrize("start_bit", [0, 7])
def test_a_checksum_may_be_any_byte_in_either_order(start_bit):
    order = "big" if start_bit == 7 else "little"
    changed_one = with_signal("Checksum", start_bit=start_bit, byte_order=order)
    assert refusals(file_of(), changed_one) == []


@pytest.mark.parametrize(
    ("second", "refused"),
    [
        ("released: 0.625, pressed: 3.75", True),
        ("released: 0.375, pressed: 4", True),  # 7.7 and 6.9 %
        ("released: 0.625, pressed: 3.4", False),  # another gradient: 112.6 % at the end
        ("released: 1.25, pressed: 4.375", False),  # another offset
        ("released: 3.75, pressed: 0.625", False),
    ],
)
def test_a_short_between_the_tracks_has_to_show(second, refused):
    found = refusals(file_of(throttle_track2=f"{{signal: Throttle2, {second}}}"))
    assert bool(found) is refused


def test_tracks_in_per_cent_of_the_node_may_have_the_same_ends_and_that_is_told():
    signals = [
        replace(one, unit="%", factor=0.1, maximum=100) if one.name.startswith("Thr") else one
        for one in POSITION.signals
    ]
    text = file_of(
        throttle="{signal: Throttle1, released: 0, pressed: 100}",
        throttle_track2="{signal: Throttle2, released: 0, pressed: 100}",
    )
    assert refusals(text, with_message(signals=tuple(signals))) == []
    (hint,) = check_effect(parse(text, "f"))
    assert hint.what == (
        "pedals.can.throttle_track2: has the ends of throttle: only the node can see a short"
        " between them"
    )


def test_one_track_is_for_a_bench_and_for_nothing_that_requires_two():
    one = file_of(throttle_track2=None, single_track_bench_use_only="true")
    assert refusals(one) == []
    assert refusals(one + "demand: {second_track_required: true}\n") == [
        "demand.second_track_required: is true, and pedals.can has one track; add throttle_track2"
    ]
    assert refusals(file_of() + "demand: {second_track_required: true}\n") == []


def test_what_the_pedals_cannot_watch_is_told():
    least = file_of(
        throttle_track2=None, single_track_bench_use_only="true", brake=None, counter=None
    )
    assert [problem.what for problem in check_effect(parse(least, "f"))] == [
        "pedals.can: has no brake: brake over throttle is not watched",
        "pedals.can: has no counter: a node that repeats its last frame is believed",
        "pedals.can: has one track: on a test bench alone",
    ]


def test_pedals_are_taken_at_the_next_start():
    assert "pedals" in RESTART_ONLY
    before, after = (parse(file_of(dead_zone_pct=zone), "f") for zone in (3, 4))
    assert reload.changed(before, after) == ("pedals.can",)
    assert not reload.is_live("pedals.can")
    assert changed(core_settings(before), core_settings(after)) == ("pedals",)


def test_the_schema_has_the_section():
    can = schema()["$defs"]["CanPedalsSection"]
    assert can["required"] == ["message", "throttle"]
    coast = can["properties"]["coast_brake_pct"]
    x, y = coast["anyOf"][1]["items"]["prefixItems"]
    assert (x["maximum"], y["maximum"], coast["x-direction"]) == (5, 30, "must not rise")
