"""Pedals: configuration, travel, judge of the reads, converters in a sysfs layout, drawing."""

import threading
from pathlib import Path

import pytest

from tests.pedals.converters import CONVERTERS, EXAMPLES, Converters
from vcu_gateway.errors import ConfigError, MissingInputError, UnavailableError
from vcu_gateway.pedals import configuration, program
from vcu_gateway.pedals.configuration import PedalsConfig
from vcu_gateway.pedals.sources import IioSource, open_source

JOYSTICK = (EXAMPLES / "joystick.yaml").read_text()
WHOLE = {"throttle": 50.0, "throttle_track2": 50.0, "brake": 50.0}


def loaded(folder: Path, text: str = CONVERTERS) -> PedalsConfig:
    file = folder / "pedals.yaml"
    file.write_text(text)
    return configuration.load(file)


def test_both_examples_are_taken_and_read_50_times_a_second(tmp_path):
    assert loaded(tmp_path).rate_hz == loaded(tmp_path, JOYSTICK).rate_hz == 50


@pytest.mark.parametrize(
    ("text", "before", "after", "line", "says"),
    [
        (JOYSTICK, "bench_use_only: true", "rate_hz: 50", "",
         "bench_use_only: must be true: an evdev device has one track; write `bench_use_only: tr"),
        (JOYSTICK, "throttle: {axis: ABS_Z, ", "throttle: {", ":6",
         "throttle.axis: is missing; an axis such as ABS_Z"),
        (JOYSTICK, "axis: ABS_RZ", "axis: BTN_RZ", ":7", "brake.axis: must be the name of an axis"),
        (JOYSTICK, "pressed: 0", "pressed: 255", ":6", "throttle: must have another value pressed"),
        (JOYSTICK, "usb-Logitech", "../usb", ":5", "device.evdev: must be a name in"),
        (JOYSTICK, "{evdev: usb-Logitech_G29-event-joystick}", "{}", ":5",
         "device: must have one of evdev and iio"),
        (JOYSTICK, "brake:", "throttle_track2:", ":7",
         "throttle_track2: must not be there: an evdev device counts as one track"),
        (CONVERTERS, "iio:device1/in_voltage0", "iio:device0/in_voltage5", ":8",
         "device.iio.throttle_track2: must be on another converter than throttle; write `bench"),
        (CONVERTERS, "iio:device1/in_voltage0", "iio:device0/in_voltage0", ":6",
         "device.iio: must have another channel for each track"),
        (CONVERTERS, "iio:device1/in_voltage0", "../x", ":8", "must be a channel, such as"),
        (CONVERTERS, "0.31, pressed: 1.92", "0.62, pressed: 3.85", ":11",
         "throttle_track2: must have another gradient or offset than throttle; a short between"),
        (CONVERTERS, "0.31, pressed: 1.92", "0.8, pressed: 3.6", ":11",
         "another gradient or offset"),
        (CONVERTERS, "{released: 0.62", "{axis: ABS_Z, released: 0.62", ":10",
         "throttle.axis: is for evdev; remove it"),
        (CONVERTERS, "    brake: iio:device0/in_voltage1\n", "", ":11",
         "brake: must stand below device.iio and at the top, or in neither"),
        (CONVERTERS, "rate_hz: 50", "rate_hz: 5", ":13", "rate_hz: must be at least 20"),
        (CONVERTERS, "dead_zone_pct", "deadzone_pct", ":14", 'did you mean "dead_zone_pct"?'),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_file_line_key_and_what_to_do(
    tmp_path, text, before, after, line, says
):
    assert before in text
    with pytest.raises(ConfigError) as refused:
        loaded(tmp_path, text.replace(before, after, 1))
    assert str(refused.value).startswith(f"{tmp_path}/pedals.yaml{line}: ")
    assert says in str(refused.value)


def test_a_second_track_that_is_missing_is_for_a_bench(tmp_path):
    kept = [line for line in CONVERTERS.splitlines() if "throttle_track2:" not in line]
    with pytest.raises(ConfigError, match="throttle_track2: is missing: one track is for a bench"):
        loaded(tmp_path, "\n".join(kept))
    bench = loaded(tmp_path, "\n".join([*kept, "bench_use_only: true"]))
    assert list(bench.tracks()) == ["throttle", "brake"]


def test_a_file_that_is_not_there_is_said(tmp_path):
    with pytest.raises(MissingInputError, match="there is no such file"):
        configuration.load(tmp_path / "pedals.yaml")


@pytest.mark.parametrize(
    ("travel_pct", "demanded"),
    [(-9, 0), (0, 0), (3, 0), (26.5, 25), (50, 50), (97, 100), (100, 100), (109, 100)],
)
def test_travel_is_linear_between_the_dead_zones(travel_pct, demanded):
    assert program.dead_zoned(travel_pct, 3) == pytest.approx(demanded)


@pytest.mark.parametrize("name", list(WHOLE))
@pytest.mark.parametrize("travel_pct", [-10.1, 110.1, float("nan")])
def test_a_track_beyond_its_ends_demands_no_throttle_and_ends_it_after_100_ms(
    tmp_path, name, travel_pct
):
    config = loaded(tmp_path)
    assert program.demand_of(config, WHOLE) == {
        "throttle_pct": 50, "throttle_track2_pct": 50, "brake_pct": 50,
        "power_mode": "eco", "regen_brake": False,
    }  # fmt: skip
    travels = WHOLE | {name: travel_pct}
    demand = program.demand_of(config, travels)
    assert demand["throttle_pct"] == demand["throttle_track2_pct"] == 0
    assert demand["brake_pct"] == (0 if name == "brake" else 50), "the brake counts where known"
    watch = program.ReadWatch(0.02)
    watch.check(0, 0, travels)
    watch.check(0.1, 0.1, travels)
    with pytest.raises(UnavailableError, match=f"beyond its travel: {name} at"):
        watch.check(0.11, 0.11, travels)


def test_a_track_that_was_beyond_for_a_moment_ends_nothing():
    watch = program.ReadWatch(0.02)
    for at_s, travel_pct in ((0, 111), (0.09, 111), (0.11, 110), (0.2, 111)):
        watch.check(at_s, at_s, {"throttle": travel_pct})


def test_two_late_reads_in_a_row_end_it_and_one_does_not():
    watch = program.ReadWatch(0.02)
    for due_s, done_s in ((0, 0.03), (0.1, 0.12), (0.2, 0.23)):
        watch.check(due_s, done_s, {})
    with pytest.raises(UnavailableError, match="late, the last one by 30 ms"):
        watch.check(0.3, 0.33, {})


def test_one_read_that_is_late_by_more_than_a_demand_lives_ends_it():
    program.ReadWatch(0.02).check(0, 0.2, {})
    with pytest.raises(UnavailableError, match="late, the last one by 201 ms"):
        program.ReadWatch(0.02).check(0, 0.201, {})


def test_a_converter_is_read_in_volts_by_scale_and_offset(tmp_path):
    converters = Converters(tmp_path)
    converters.write("iio:device1/in_voltage0", "0.5", "scale")
    converters.write("iio:device1/in_voltage0", "10", "offset")
    source = IioSource(loaded(tmp_path).device.iio.tracks(), converters.folder)
    assert source.read() == {"throttle": 0.62, "throttle_track2": 0.16, "brake": 0.5}
    converters.press(100)
    assert source.read() == {"throttle": 3.85, "throttle_track2": 0.965, "brake": 0.5}
    source.close()


def test_a_differential_channel_has_the_scale_of_its_kind(tmp_path):
    converters = Converters(tmp_path)
    converters.write("iio:device0/in_voltage2-voltage3", "400")
    converters.write("iio:device0/in_voltage-voltage", "2.5", "scale")
    source = IioSource({"brake": "iio:device0/in_voltage2-voltage3"}, converters.folder)
    assert source.read() == {"brake": 1.0}
    source.close()


@pytest.mark.parametrize("missing", ["in_voltage0_raw", "in_voltage_scale"])
def test_a_converter_that_is_not_there_is_said_with_how_to_find_it(tmp_path, missing):
    converters = Converters(tmp_path)
    (converters.folder / "iio:device1" / missing).unlink()
    with pytest.raises(UnavailableError) as refused:
        open_source(loaded(tmp_path), converters.folder)
    assert "iio:device1/in_voltage0" in str(refused.value)
    assert f"`grep . {converters.folder}/*/name` shows what is there" in str(refused.value)


def test_show_draws_each_track_with_what_was_seen_and_demands_nothing(tmp_path):
    converters, stop, drawn = Converters(tmp_path), threading.Event(), []

    def draw(text: str) -> None:
        drawn.append(text.splitlines())
        if len(drawn) == 1:
            converters.press(50)
        elif len(drawn) == 2:
            converters.write("iio:device0/in_voltage1", "5000")
        else:
            stop.set()

    source = IioSource(loaded(tmp_path).device.iio.tracks(), converters.folder)
    program.show(loaded(tmp_path), source, draw, stop)
    source.close()
    assert drawn[0][0] == f"throttle{0.62:18g}  [{'.' * 20}]    0 %  seen 0.62 to 0.62"
    assert drawn[1][0] == (
        f"throttle{2.235:18g}  [{'#' * 10}{'.' * 10}]   50 %  seen 0.62 to 2.235"
    )
    assert drawn[2][2] == f"brake{5:21g}  [beyond its travel...]  112 %  seen 0.5 to 5"
