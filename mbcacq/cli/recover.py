"""``mbcacq recover``: make a torn recording readable, or check one bit for bit."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo


@click.command("recover")
@click.argument("recording", type=RunPath(every_kind=True))
@click.option("--check", is_flag=True, help="Only compare every file of the run with the checksums of what was written.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(recording: Path, check: bool, as_json: bool) -> None:
    """Make RECORDING (a run folder or a .rrd file) readable after a crash, a power cut or a full disk.

    Everything complete before the tear goes into a copy, NAME.recovered.rrd; the original is not touched. All commands that
    take a run folder use the copy from then on.

    With --check nothing is written: each bit that changed since it was written is named by file, bytes and pose, and the command ends with
    exit code 6 if there is one.
    """
    from mbcacq.cli.signals import end_in_order_on_signals
    from mbcacq.recording.run_folder.recovery import recover

    end_in_order_on_signals("the recovery")
    if check:
        print_check(recording, as_json)
        return
    with StepProgress() as steps:
        steps.begin("reading what is whole")
        found = recover(recording)
    if as_json:
        from mbcacq.model.json_text import fields_as_json

        recordings = [fields_as_json(item) | {"damaged": item.damaged} for item in found]
        echo(json.dumps({"format": "mbcacq-recovery/1", "recordings": recordings}))
        return
    for item in found:
        content = f"{item.poses} finished poses, {item.cycles} controller cycles"
        end = "" if item.complete else "; the run did not come to its end"
        if item.damaged:
            echo(f"{item.source}: torn or damaged; {content} are in {item.output}{end}")
        else:
            echo(f"{item.source}: nothing to do, {content}{end}")
    if recording.is_dir() and not all(item.complete for item in found):
        say_next("go on where the run ended", command_line("run", "--resume", recording))
    else:
        say_next("calibrate with what is there", command_line("calibrate", recording if recording.is_dir() else found[-1].output))


def print_check(recording: Path, as_json: bool) -> None:
    """Raises RecordingError if anything is not as it was written."""
    from mbcacq.errors import RecordingError
    from mbcacq.recording.run_folder.check import check

    with StepProgress() as steps:
        steps.begin("comparing the recording with its checksums")
        found = check(recording)
    if as_json:
        files = [{"file": str(f.path), "bytes": f.size, "unverified": f.unverified, "faults": list(f.faults)} for f in found]
        echo(json.dumps({"format": "mbcacq-checksums/1", "files": files}))
    else:
        for file in found:
            unverified = f", {file.unverified} of them without a checksum" if file.unverified else ""
            echo(f"{file.path}: {len(file.faults) or 'no'} fault{'s' * (len(file.faults) != 1)} in {file.size} bytes{unverified}")
            for fault in file.faults:
                echo(f"  {fault}")
    if number := sum(len(file.faults) for file in found):
        raise RecordingError(
            f"{number} fault{'s' * (number != 1)} in {recording}: poses named are left out by calibrate and measured anew by run --resume; "
            "a recording that cannot be read is made readable by mbcacq recover; what was computed, calibrate and diagnose compute anew"
        )
