"""``mbcacq plan copy``: one of the tool's plans with its files, where the user can edit it."""

from __future__ import annotations

from pathlib import Path

from mbcacq.cli.declared import FOLDER, argument, option, subcommand
from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.terminal import echo
from mbcacq.workflow import copy_plan


@subcommand("copy")
def copy(
    name: str = argument(), folder: Path = argument(FOLDER, default=Path()), force: bool = option("Replace what is already there.")
) -> None:
    """Put the plan NAME that came with mbcacq, with its robot and artefact files, into FOLDER (default: here).

    \b
    Example:
      mbcacq plan copy kuka my-cell
    """
    written = copy_plan.copy_plan(name, folder, force=force)
    for path in written:
        echo(str(path))
    say_next("look at it, change what differs in your cell", command_line("plan", "check", written[0]))
