"""`vcu-gateway recordings`: what the recorder has written, listed, checked, kept, removed."""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from vcu_gateway import text
from vcu_gateway.cli.options import ANY_PATH, file_option, json_option, moment_of
from vcu_gateway.errors import MissingInputError, Problem
from vcu_gateway.recording import check
from vcu_gateway.recording.check import CheckedRecording, check_recording
from vcu_gateway.recording.folder import RecordingFolder, RecordingPath, RecordingSummary, summarise
from vcu_gateway.recording.keep import (
    act_as_owner,
    keep_now,
    keep_part,
    keep_whole,
    remove_recording,
    running,
)
from vcu_gateway.recording.layout import DEFAULT_FOLDER, plain_reason
from vcu_gateway.recording.recorder_status import STATUS_PATH
from vcu_gateway.time_window import Window

_NOW = "now"
_UNKNOWN = "-"
_HEAD = ("NAME", "BEGAN (UTC)", "DURATION", "SIZE", "GAPS", "")
_MOST_FAULTS = 100

folder_option = file_option(
    "--folder",
    "folder_path",
    metavar="FOLDER",
    type=ANY_PATH,
    default=DEFAULT_FOLDER,
    show_default=True,
    help="Where the recordings are.",
)


def _opened(path: Path) -> RecordingFolder:
    """The folder; with root's rights given up, for they are not needed."""
    act_as_owner(path)
    return RecordingFolder(path)


@click.group("recordings")
def recordings() -> None:
    """List, check, keep and remove what the recorder has written.

    Neither a gateway nor the recorder has to run. Drives and incidents are named as `list` shows
    them; all times are UTC. Members of the group vcu-gateway-recorder may list and check; to
    keep and to remove, use sudo.
    """


@recordings.command("list")
@folder_option
@json_option
def list_command(folder_path: Path, as_json: bool) -> None:
    """List drives and incidents: begin, duration, size, gaps, and why an incident is kept."""
    found = [summarise(recording) for recording in _opened(folder_path).recordings()]
    if as_json:
        values = [{**one._asdict(), "lost": one.lost and one.lost._asdict()} for one in found]
        click.echo(json.dumps({"recordings": values}))
        return
    for line in _listed(found, str(folder_path)):
        click.echo(line)


def _listed(found: Sequence[RecordingSummary], folder: str) -> Iterator[str]:
    for kind in ("drive", "incident"):
        rows = [_row(one) for one in found if one.kind == kind]
        yield f"{text.counted(len(rows), kind)} in {folder}/{kind}s"
        if rows:
            yield from text.table([_HEAD, *rows], indent="  ")
        yield ""
    drives_bytes = sum(one.size_bytes for one in found if one.kind == "drive")
    yield f"{text.size(drives_bytes)} of drives; while a drive is there, its incidents take no room"


def _row(one: RecordingSummary) -> tuple[str, ...]:
    notes = [*one.reasons, *(["being written"] if one.is_written else [])]
    notes += ["kept"] if one.kept else []
    gaps = _UNKNOWN if one.lost is None else "none"
    if one.lost is not None and one.lost.gaps:
        gaps = f"{one.lost.gaps} ({one.lost.frames} frames)"
    return (
        one.name,
        _UNKNOWN if one.begun_wall_ns is None else text.utc(one.begun_wall_ns),
        _UNKNOWN if one.duration_s is None else text.duration(one.duration_s * 1000),
        text.size(one.size_bytes),
        gaps,
        "; ".join([*notes, *one.problems]),
    )


@recordings.command("check")
@click.argument("names", metavar="[NAME]...", nargs=-1)
@folder_option
@file_option(
    "--allowed-signers",
    type=ANY_PATH,
    help="Keys (ssh-keygen(1), ALLOWED SIGNERS) of which one has to have signed every segment.",
)
@json_option
def check_command(
    names: tuple[str, ...], folder_path: Path, allowed_signers: Path | None, as_json: bool
) -> None:
    """Read recordings whole: is each piece there, and what the recorder wrote?

    Without NAME all of them. The chain is followed from the first member to the closing record,
    the files beside it are compared with their digests, each command with its echo, and received =
    recorded + gaps. What is torn, damaged, changed or missing is shown with its file and place, and
    the rest is read. Exit code 3 where something is missing, 65 where something is changed or
    damaged. A chain shows no change by somebody who made all of it anew: signatures do.
    """
    folder = _opened(folder_path)
    chosen = [folder.named(name) for name in names] or folder.recordings()
    if allowed_signers is not None:
        allowed_signers = _readable(allowed_signers)
    results = []
    for result in _checked(chosen, allowed_signers):
        results.append(result)
        if not as_json:
            click.echo(f"{result.name}: {check.headline(result)}; {_sum(result)}")
            for line in check.fault_lines(result, _MOST_FAULTS):
                click.echo(line)
    if as_json:
        whole = all(result.is_whole for result in results)
        document = {"whole": whole, "recordings": [check.values(one) for one in results]}
        click.echo(json.dumps(document))
    if code := max((result.exit_code for result in results), default=0):
        sys.exit(code)


def _readable(path: Path) -> Path:
    try:
        path.read_bytes()
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise MissingInputError(Problem(what, str(path), "a line for each: NAME KEY")) from error
    return path.resolve()


def _checked(
    chosen: list[RecordingPath], allowed_signers: Path | None
) -> Iterator[CheckedRecording]:
    """Each in turn, with a line of progress where a person waits."""
    progress = text.Progress()
    for number, recording in enumerate(chosen, 1):
        where, read_bytes = f"{recording.name} ({number} of {len(chosen)})", [0]

        def show(size: int, where: str = where, read_bytes: list[int] = read_bytes) -> None:
            read_bytes[0] += size
            progress.show(f"{where}: {text.size(read_bytes[0])}")

        yield check_recording(recording, show, allowed_signers)
        progress.clear()


def _sum(found: CheckedRecording) -> str:
    gaps = found.gaps
    received = found.frames + gaps.frames + found.missing_frames
    in_gaps = f" + {gaps.frames} in {text.counted(gaps.gaps, 'gap')}"
    missing = f" + {found.missing_frames} missing" if found.missing_frames else ""
    ticks = f", {found.missing_ticks} ticks missing" if found.missing_ticks else ""
    frames = f"{received} frames received = {found.frames} recorded{in_gaps}{missing}"
    return f"{text.counted(found.segments, 'segment')}, {frames}{ticks}"


@recordings.command("keep")
@click.argument("name", metavar="NAME|now")
@folder_option
@click.option("--from", "begin", metavar="TIME", help="Only from here on: 12:03, 90 (s), a date.")
@click.option("--to", "end", metavar="TIME", help="Only up to here.")
@click.option("--reason", metavar="TEXT", help="Why; shown by list. For now, or a part.")
@file_option(
    "--status",
    "status_path",
    type=ANY_PATH,
    show_default=f"{STATUS_PATH.name} in FOLDER, else {STATUS_PATH}",
    help="Where the running recorder says how it goes; for now.",
)
def keep_command(
    name: str,
    folder_path: Path,
    begin: str | None,
    end: str | None,
    reason: str | None,
    status_path: Path | None,
) -> None:
    """Keep a recording: the recorder never removes it.

    now asks the running recorder for an incident of this moment: the minute before, and the
    half minute that follows; one that is open already takes it in. NAME keeps a drive or an
    incident whole; with --from, --to or --reason it makes an incident of that part, which takes no
    room while the drive is there.
    """
    folder = _opened(folder_path)
    if name == _NOW:
        if begin or end:
            raise click.UsageError("now takes no --from or --to")
        recorder = running(folder, status_path)
        asked = keep_now(folder, recorder.pid, plain_reason(reason or ""))
        click.echo(asked or "asked; the incident is there once the disk has taken it")
        return
    recording = folder.named(name)
    if not (begin or end or reason):
        kept = keep_whole(recording)
        click.echo(f"{name} stays until somebody removes it" if kept else f"{name} is kept already")
        return
    window = Window(moment_of(begin, "--from"), moment_of(end, "--to"))
    start_ns = summarise(recording).begun_wall_ns or 0
    begin_ns, end_ns = window.bounds_ns(start_ns)
    if begin_ns > end_ns:
        raise click.UsageError(f"--from {begin} is after --to {end}: exchange them")
    made = keep_part(folder, recording, begin_ns, end_ns, plain_reason(reason or ""))
    click.echo(made.name)


@recordings.command("remove")
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@folder_option
@click.option("--yes", is_flag=True, help="Do not ask.")
def remove_command(names: tuple[str, ...], folder_path: Path, yes: bool) -> None:
    """Remove drives or incidents from the disk, after a question.

    Never one that is being written, nothing outside the folder, and no file that is none of a
    recording's: a folder with others in it stays, with them. What an incident has in common with
    its drive is gone from the disk when both are removed.
    """
    folder = _opened(folder_path)
    chosen = [folder.named(name) for name in names]
    if not yes:
        _ask(chosen)
    for recording in chosen:
        others = remove_recording(recording)
        click.echo(f"{recording.name} is removed")
        if others:
            click.echo(
                f"{recording.path} stays: {', '.join(others)} in it is no recording", err=True
            )


def _ask(chosen: list[RecordingPath]) -> None:
    """Ask on a terminal; without one, --yes has to be said."""
    for line in text.table([_row(summarise(one)) for one in chosen], indent="  "):
        click.echo(line)
    if not sys.stdin.isatty():
        raise click.UsageError("nobody is there to be asked: say --yes")
    click.confirm("Remove for good?", abort=True)
