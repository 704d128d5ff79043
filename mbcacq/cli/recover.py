"""``mbcacq recover``: make a torn recording readable, or check one bit for bit."""

from __future__ import annotations

from pathlib import Path

from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.cli.step_progress import StepProgress
from mbcacq.errors import RecordingError
from mbcacq.model.json_text import fields_as_json
from mbcacq.recording.run_folder import check as folder_check
from mbcacq.recording.run_folder import recovery, register


@subcommand("recover")
def command(
    recording: Path = argument(RunPath(every_kind=True)),
    check: bool = option("Only compare every file of the run with the checksums of what was written."),
) -> Answer:
    """Make RECORDING (a run folder or a .rrd file) readable after a crash, a power cut or a full disk.

    Everything complete before the tear goes into a copy, NAME.recovered.rrd; the original is not touched. All commands that
    take a run folder use the copy from then on.

    With --check nothing is written: each bit that changed since it was written is named by file, bytes and pose, and the command ends with
    exit code 6 if there is one.
    """
    end_in_order_on_signals("the recovery")
    if check:
        return checked(recording)
    with StepProgress("reading what is whole"):
        found = recovery.recover(recording)
    recordings = [fields_as_json(item) | {"damaged": item.damaged} for item in found]
    then = "calibrate with what is there", command_line("calibrate", recording if recording.is_dir() else found[-1].output)
    if recording.is_dir() and not all(item.complete for item in found):
        then = "go on where the run ended", command_line("run", "--resume", recording)
    elif recording.is_dir() and register.kind_of(recording) is register.RunKind.CHECK:
        then = "read what the check said", command_line("report", recording)
    return Answer({"format": "mbcacq-recovery/1", "recordings": recordings}, map(line_of, found), then)


def line_of(item: recovery.Recovered) -> str:
    content = f"{item.poses} finished poses, {item.cycles} controller cycles"
    end = "" if item.complete else "; the run did not come to its end"
    if item.damaged:
        return f"{item.source}: torn or damaged; {content} are in {item.output}{end}"
    return f"{item.source}: nothing to do, {content}{end}"


def checked(recording: Path) -> Answer:
    """What is not as it was written. Its end raises RecordingError if there is anything."""
    with StepProgress("comparing the recording with its checksums"):
        found = folder_check.check(recording)
    lines = []
    for file in found:
        unverified = f", {file.unverified} of them without a checksum" if file.unverified else ""
        lines.append(f"{file.path}: {len(file.faults) or 'no'} fault{'s' * (len(file.faults) != 1)} in {file.size} bytes{unverified}")
        lines += [f"  {fault}" for fault in file.faults]

    def refuse_faults() -> None:
        if number := sum(len(file.faults) for file in found):
            faults = f"{number} fault{'s' * (number != 1)} in {recording}"
            raise RecordingError(
                f"{faults}: poses named are left out by calibrate and measured anew by run --resume; "
                "a recording that cannot be read is made readable by mbcacq recover; what was computed, calibrate and diagnose compute anew"
            )

    files = [{"file": str(f.path), "bytes": f.size, "unverified": f.unverified, "faults": list(f.faults)} for f in found]
    return Answer({"format": "mbcacq-checksums/1", "files": files}, lines, end=refuse_faults)
