"""`vcu-gateway replay`: a recording decided again, with its own configuration or another."""

import gc
import json
import sys
from pathlib import Path

import click

from vcu_gateway import text
from vcu_gateway.cli.options import config_file_option, file_option, json_option, moment_of
from vcu_gateway.recording.folder import recorded_path
from vcu_gateway.replay.configuration import Changes
from vcu_gateway.replay.drive_replay import replay_drive
from vcu_gateway.replay.log_replay import replay_log
from vcu_gateway.time_window import Window

_HELP = """Decide a recorded drive again: is it the same to the byte, and what if?

RECORDING is a drive's or an incident's folder, its name below
/var/lib/vcu-gateway-recorder, one segment's file in it, or any log that `decode` reads.

\b
vcu-gateway replay DRIVE
    with its own configuration: the same frames, modes, events, answers and sentences
    of `why`, else the first difference; and a verdict on reaction times, the gate's
    rules and the invariants, by code that shares nothing with the gateway.
vcu-gateway replay DRIVE --set limits.throttle_slew_pct_per_s=50
vcu-gateway replay DRIVE -c other.yaml
    what if: commands, causes, stops and requests that differ. Open loop: the recorded
    vehicle does not react. The configuration holds for the whole drive.
vcu-gateway replay DRIVE --set ... --closed-loop
    the recorded demands drive a simulated vehicle, once with each configuration.
vcu-gateway replay drive.log [--demand PCT]
    a log of the bus has no demands and no ticks: decisions on its frames, every 50 ms.

--from and --to name a part: seconds since the beginning, a time of day or a date with it. It begins
with the segment in which that time lies.

Times are UTC. The exit code is 0 where nothing differs and the verdict holds, 1 where something
differs, 3 where nothing does and the recording is incomplete, 65 where it was changed or damaged.
"""


@click.command("replay", help=_HELP)
@click.argument("recording", metavar="RECORDING")
@config_file_option("What if: another configuration, for the whole drive.")
@click.option(
    "--set",
    "assignments",
    metavar="KEY=VALUE",
    multiple=True,
    help="What if: one key, such as limits.power_limit_max_w=8000; repeatable.",
)
@click.option("--closed-loop", is_flag=True, help="Let a simulated vehicle react.")
@click.option("--from", "begin", metavar="TIME", help="Begin of the part: 90, 12:03:14.150.")
@click.option("--to", "end", metavar="TIME", help="End of the part.")
@click.option(
    "--demand",
    "demand_pct",
    metavar="PCT",
    type=click.FloatRange(0, 100),
    help="For a log: hold this throttle, armed as soon as nothing speaks against it.",
)
@json_option
@file_option(
    "--html",
    "html_path",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Also write an offline report with plots; an old FILE is replaced.",
)
@click.option("-q", "--quiet", is_flag=True, help="Say nothing; the exit code tells.")
def replay(
    recording: str,
    config_path: Path | None,
    assignments: tuple[str, ...],
    closed_loop: bool,
    begin: str | None,
    end: str | None,
    demand_pct: float | None,
    as_json: bool,
    html_path: Path | None,
    quiet: bool,
) -> None:
    changes = Changes(config_path, assignments)
    window = Window(moment_of(begin, "--from"), moment_of(end, "--to"))
    plotted, progress = html_path is not None, text.Progress(wanted=not quiet)
    gc.disable()  # next to no garbage in a replay has cycles, and looking for it takes a tenth
    found = recorded_path(recording)
    if found is not None:
        if demand_pct is not None:
            raise click.BadParameter("a recorded drive has its own demands", param_hint="--demand")
        report = replay_drive(found, changes, window, closed_loop, plotted, progress)
    elif closed_loop:
        what = "a log has no demands to drive with"
        raise click.BadParameter(what, param_hint="--closed-loop")
    else:
        report = replay_log(recording, changes, window, demand_pct, plotted, progress, text.say)
    if html_path is not None:
        report.write_html(html_path)
    if not quiet:
        values = json.dumps(report.values, ensure_ascii=False) if as_json else ""
        click.echo(values or "\n".join(report.lines))
    if report.exit_code:
        sys.exit(report.exit_code)
