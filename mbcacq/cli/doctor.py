"""``mbcacq doctor``: what is missing, and what to do about it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from mbcacq import doctor as checking
from mbcacq import plan as planning
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.errors import ExitCode
from mbcacq.files.atomic_write import write_file

COLOURS = {"ok": "green", "warning": "yellow", "error": "red"}
DEVICES = ("robot", "scanner", "positioner", "sensor", "devices")


@subcommand("doctor")
def command(
    as_json: bool,
    plan: Path | None = argument(PlanPath(), required=False),
    protocol: bool = option("Instead: a protocol for the first contact of PLAN with real devices, to be ticked."),
    evidence: Path | None = option(
        "Instead: what the devices of a run said, as one JSON file to be sent.", RunPath(every_kind=True), metavar="RUN"
    ),
    anonymous: bool = option("With --evidence: without addresses, users and serial numbers."),
    out: Path | None = option("Where --protocol and --evidence write to [default: stdout]."),
    arm: bool = option("Connect a real robot too, which can switch its drives on; it is not moved."),
) -> Answer | None:
    """Look at this computer: Python, libraries, drivers, disk, real-time rights, pictures; with PLAN also at its ports and network
    interface, and ask every device who it is.

    It prints one line for each thing, with a cure if something is wrong. The exit code is 3 if a device cannot be reached, and 2 if
    anything else is wrong.

    \b
    Examples:
      mbcacq doctor
      mbcacq doctor plans/kuka.yaml
      mbcacq doctor --protocol my-cell.yaml --out first-contact.md
      mbcacq doctor --evidence latest --anonymous --out evidence.json
    """
    if protocol or evidence is not None:
        return write(page_of(plan) if evidence is None else json_of(evidence, anonymous), out)
    loaded = None if plan is None else planning.load(plan)
    found = []
    with StepProgress() as progress:
        for line in checking.checkup(loaded, arm, progress):
            found.append(line)
            if not as_json:
                progress.clear()
                print_line(line)
    wrong = [line for line in found if line.level == "error"]

    def refuse_errors() -> None:
        if wrong:
            sys.exit(ExitCode.UNREACHABLE if any(line.topic.startswith(DEVICES) for line in wrong) else ExitCode.USAGE)

    document = {"format": "mbcacq-doctor/1", "errors": len(wrong), "lines": [line.to_dict() for line in found]}
    return Answer(document, then=next_step(plan, bool(wrong)), end=refuse_errors)


def next_step(plan: Path | None, wrong: bool) -> tuple[str, str]:
    """What to do after a look at the computer, and the command for it."""
    if wrong:
        return "do what the arrows say, then look again", command_line("doctor", plan or "")
    return "try it without hardware", command_line("run", plan or "kuka", "--dry-run")


def page_of(plan: Path | None) -> str:
    """The protocol of a first contact. Raises UsageError without a plan."""
    from mbcacq.doctor.first_contact import protocol

    if plan is None:
        raise click.UsageError("--protocol needs a PLAN: the steps are those of its drivers")
    return protocol(planning.load(plan))


def json_of(run: Path, anonymous: bool) -> str:
    """What the devices of a run said."""
    from mbcacq.doctor.evidence import evidence

    return json.dumps(evidence(run, anonymous), indent=1, ensure_ascii=False) + "\n"


def write(text: str, out: Path | None) -> None:
    """To a file, or to standard output. Raises RecordingError where the file cannot be written."""
    if out is None:
        echo(text.rstrip("\n"))
        return
    write_file(out, text)
    echo(f"written: {out}", err=True)


def print_line(line: checking.CheckupLine) -> None:
    """One line, and its cure below it."""
    echo(f"  {line.topic}: {line.text}", label=(f"{line.level:7}", COLOURS[line.level]))
    if line.cure:
        echo(f"         -> {line.cure}")
