"""`vcu-gateway recordings`: what the recorder has written, listed, checked, kept, removed."""

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from vcu_gateway.cli import recordings_text as text
from vcu_gateway.drive_format.layout import DEFAULT_FOLDER, plain_reason
from vcu_gateway.drive_format.recorder_status import STATUS_PATH
from vcu_gateway.errors import MissingInputError, Problem
from vcu_gateway.recordings import (
    CheckedRecording,
    RecordingFolder,
    RecordingPath,
    act_as_owner,
    check_recording,
    keep_part,
    keep_whole,
    remove_recording,
    summarise,
)
from vcu_gateway.recordings.running_recorder import keep_now, running
from vcu_gateway.time_window import Moment, Window, moment

_NOW = "now"

folder_option = click.option(
    "--folder",
    "folder_path",
    metavar="FOLDER",
    type=click.Path(path_type=Path, readable=False),
    default=DEFAULT_FOLDER,
    show_default=True,
    help="Where the recordings are.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object.")


def _opened(path: Path) -> RecordingFolder:
    """The folder; with root's rights given up, for they are not needed."""
    act_as_owner(path)
    return RecordingFolder(path)


@click.group("recordings")
def command() -> None:
    """List, check, keep and remove what the recorder has written.

    Neither a gateway nor the recorder has to run. Drives and incidents are named as `list` shows
    them; all times are UTC. Members of the group vcu-gateway-recorder may list and check; to
    keep and to remove, use sudo.
    """


@command.command("list")
@folder_option
@json_option
def list_command(folder_path: Path, as_json: bool) -> None:
    """List drives and incidents: begin, duration, size, gaps, and why an incident is kept."""
    found = [summarise(recording) for recording in _opened(folder_path).recordings()]
    if as_json:
        click.echo(json.dumps({"recordings": [text.summary_json(one) for one in found]}))
        return
    for line in text.listed(found, str(folder_path)):
        click.echo(line)


@command.command("check")
@click.argument("names", metavar="[NAME]...", nargs=-1)
@folder_option
@click.option(
    "--allowed-signers",
    metavar="FILE",
    type=click.Path(path_type=Path, readable=False),
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
            click.echo("\n".join(text.check_lines(result)))
    if as_json:
        whole = all(result.is_whole for result in results)
        document = {"whole": whole, "recordings": [text.check_json(one) for one in results]}
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
    shown = sys.stderr.isatty()
    for number, recording in enumerate(chosen, 1):
        where = f"{recording.name} ({number} of {len(chosen)})"
        progress = _progress(where) if shown else lambda _: None
        yield check_recording(recording, progress, allowed_signers)
        if shown:
            click.echo("\r\033[K", nl=False, err=True)


def _progress(where: str) -> Callable[[int], None]:
    read_bytes = 0

    def show(size: int) -> None:
        nonlocal read_bytes
        read_bytes += size
        click.echo(f"\r{where}: {text.size(read_bytes)} ", nl=False, err=True)

    return show


@command.command("keep")
@click.argument("name", metavar="NAME|now")
@folder_option
@click.option("--from", "begin", metavar="TIME", help="Only from here on: 12:03, 90 (s), a date.")
@click.option("--to", "end", metavar="TIME", help="Only up to here.")
@click.option("--reason", metavar="TEXT", help="Why; shown by list. For now, or a part.")
@click.option(
    "--status",
    "status_path",
    metavar="FILE",
    type=click.Path(path_type=Path, readable=False),
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
    window = Window(_moment("--from", begin), _moment("--to", end))
    start_ns = summarise(recording).begun_wall_ns or 0
    begin_ns, end_ns = window.bounds_ns(start_ns)
    if begin_ns > end_ns:
        raise click.UsageError(f"--from {begin} is after --to {end}: exchange them")
    made = keep_part(folder, recording, begin_ns, end_ns, plain_reason(reason or ""))
    click.echo(made.name)


def _moment(option: str, text: str | None) -> Moment | None:
    try:
        return None if text is None else moment(text)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint=option) from error


@command.command("remove")
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
    found = [summarise(recording) for recording in chosen]
    for line in text.chosen_lines(found):
        click.echo(line)
    if not sys.stdin.isatty():
        raise click.UsageError("nobody is there to be asked: say --yes")
    click.confirm("Remove for good?", abort=True)
