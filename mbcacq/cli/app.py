"""The command group: names and one-line helps stand here. A command is imported when it is called, and what it imports when it is used."""

from __future__ import annotations

import errno
import importlib
import importlib.util
import io
import os
import re
import sys
import traceback
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import NoReturn

import click

from mbcacq.cli.next_step import say_after_failure
from mbcacq.cli.signals import ended_by_signal
from mbcacq.cli.terminal import echo
from mbcacq.errors import EXIT_CODE_MEANING, ExitCode, MbcacqError, nearest
from mbcacq.version import __version__

FULL = (errno.ENOSPC, errno.EDQUOT)
COMMANDS = {
    "run": "execute a plan, record it, calibrate the cell",
    "investigate": "measure until the cell is known: choose visit after visit by what is still in question",
    "collect": "calibrate from clouds that the scanner's own program saved",
    "plan": "make, show, check or design a plan, without opening a socket",
    "robot": "make a robot file from a URDF, an MJCF file or a table of DH rows",
    "data": "make an observation set of files from other programs",
    "hand-eye": "calibrate a camera's hand-eye transformation view by view",
    "calibrate": "calibrate the cell from a run, a recording or an observation set",
    "compare": "compare calibration methods on the same data",
    "diagnose": "say where model and recording differ, and which effects the model lacks",
    "verify": "try a calibrated arm with its effects on a recording that it was not fitted to",
    "fleet": "calibrate many recordings on a cluster, compare the arms over time",
    "check": "repeat a few poses, and say whether anything changed since the calibration",
    "correct": "joint angles that reach the nominal places with the calibrated arm",
    "simulate": "write what a plan would record by the calibrated model",
    "challenge": "inject effects into the fake cell, diagnose without knowing them, score",
    "report": "write the report of a run: one HTML page",
    "view": "open a recording in the rerun viewer",
    "serve": "show runs, reports and a run that goes on in a browser, on this computer only",
    "export": "write results or observations in the formats of other programs",
    "apply": "bring a scan taken at a pose into the base frame",
    "merge": "put the scans of a part together, and say how well they agree",
    "recover": "make a torn recording readable",
    "fakes": "start the fake cell of a plan in the foreground",
    "controller-files": "write the programs and settings for the robot's controller",
    "doctor": "say what is missing for a run, and what to do about it",
    "drivers": "list the installed drivers",
    "schema": "print the JSON Schema of a plan",
    "diagnosis-schema": "print the JSON Schema of a diagnosis",
}


def refused_by_the_system(error: Exception) -> str:
    """A sentence where the cause lies in the computer and not in this program; '' for any other error."""
    lacking = isinstance(error, ImportError | RuntimeError) and re.search("failed to map|annot allocate|start new thread", str(error))
    if isinstance(error, MemoryError) or lacking:
        return f"the computer has too little memory for this ({error}); free some, or raise the limit that is set (ulimit -v)"
    if isinstance(error, OSError) and error.errno is not None:
        where = f"{str(error.filename)[:200]}: " if error.filename else ""
        return f"the system refused a file, a connection or memory: {where}{error.strerror or error}; look at the disk, limits and rights"
    return ""


def place_in_a_given_file(error: Exception) -> str:
    """'FILE:LINE' of the Python file that the command was given (an effect of the user's), where the error arose in it; else ''."""
    given = {Path(word.rpartition("=")[2]).resolve() for word in sys.argv[1:] if word.endswith(".py")}
    places = re.findall(r'File "(.+?)", line (\d+)', "".join(traceback.format_exception(error)))
    return next((f"{file}:{line}" for file, line in reversed(places) if Path(file).resolve() in given), "")


def end_interrupted(how: BaseException | None = None) -> NoReturn:
    """End with the sentence and the code of what a signal raised."""
    echo(f"mbcacq: {how}" if isinstance(how, MbcacqError) else "mbcacq: interrupted", err=True)
    say_after_failure()
    sys.exit(how.exit_code if isinstance(how, MbcacqError) else ExitCode.INTERRUPTED)


def end_unexpected(error: Exception) -> NoReturn:
    """End with the sentence and the code of an error that none of ours is."""
    if os.environ.get("MBCACQ_DEBUG"):
        raise error
    if ended := ended_by_signal():  # a library made another error of it
        end_interrupted(ended)
    if isinstance(error, OSError) and error.errno in FULL:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # where not even our words find room
        where = error.filename or "the output"
        echo(f"mbcacq: no space is left where it writes to ({where}); free some and try again", err=True)
        sys.exit(ExitCode.RECORDING_FAILED)
    if sentence := refused_by_the_system(error):
        echo(f"mbcacq: {sentence}", err=True)
        sys.exit(ExitCode.SYSTEM_REFUSED)
    if given := place_in_a_given_file(error):
        echo(f"mbcacq: {given}: {type(error).__name__}: {error}; correct this file", err=True)
        sys.exit(ExitCode.USAGE)
    echo(f"mbcacq: unexpected {type(error).__name__}: {error} (a bug: please report it; MBCACQ_DEBUG=1 shows where)", err=True)
    sys.exit(ExitCode.BUG)


class ModulesOnFirstUse:
    """A finder of this program's modules. ``from mbcacq.workflow import load`` gives a module that runs when one of its names is first
    asked for. A command that only prints its help, or completes a word, waits for none of them."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """The module, as ``sys.meta_path`` asks for it; None for those of others."""
        spec = PathFinder.find_spec(name, path) if name.startswith("mbcacq.") else None  # type: ignore[arg-type]
        if spec is not None and spec.loader is not None:
            spec.loader = importlib.util.LazyLoader(spec.loader)
        return spec


class LazyGroup(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        sys.meta_path.insert(0, ModulesOnFirstUse)  # type: ignore[arg-type]
        try:
            return importlib.import_module(f"mbcacq.cli.{cmd_name.replace('-', '_')}").command
        finally:
            sys.meta_path.remove(ModulesOnFirstUse)  # type: ignore[arg-type]

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """As of a group, with the commands that are called almost the same."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-") and (near := nearest(args[0], COMMANDS)):
            ctx.fail(f"there is no command '{args[0]}'{near}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> object:
        """Who reads our output may have enough of it, as `head` has: that is no error."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is still in the buffer goes nowhere
            return ExitCode.OK
        except SystemExit as end:
            if isinstance(end.__context__, BrokenPipeError):  # rich's way of saying it
                return ExitCode.OK
            raise

    def main(self, *args, standalone_mode: bool = True, **kwargs):
        """Run, and end with the exit code that belongs to what happened: one sentence on stderr, no stack trace."""
        if not standalone_mode:
            return super().main(*args, standalone_mode=False, **kwargs)
        try:
            code = super().main(*args, standalone_mode=False, **kwargs)
            sys.exit(code if isinstance(code, int) else ExitCode.OK)
        except click.ClickException as error:
            shown = io.StringIO()
            error.show(shown)
            echo(shown.getvalue(), err=True, nl=False)
            sys.exit(ExitCode.USAGE)
        except (KeyboardInterrupt, click.Abort):
            end_interrupted()
        except MbcacqError as error:
            echo(f"mbcacq: {error}", err=True)
            say_after_failure()
            sys.exit(error.exit_code)
        except Exception as error:
            end_unexpected(error)


EPILOG = "Exit codes: " + ", ".join(f"{code.value} {EXIT_CODE_MEANING[code]}" for code in ExitCode) + "."


FIRST = """mbcacq calibrates and diagnoses a robot arm that carries a 3D scanner. What people do first:

  mbcacq run kuka --dry-run     a whole run against a fake cell on this computer, half a minute: runs/latest/report.html
  mbcacq plan copy kuka         a plan with its files here, to be changed for your own cell
  mbcacq report DATA            calibrate and judge data that you have: a recording, a folder of CSV, a ROS bag

All commands: mbcacq --help. Each has its own help: mbcacq run --help."""


@click.group(
    cls=LazyGroup,
    epilog=EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
    invoke_without_command=True,
    no_args_is_help=False,
)
@click.version_option(__version__, prog_name="mbcacq")
@click.pass_context
def app(context: click.Context) -> None:
    """Acquire with a robot-mounted 3D scanner, calibrate the cell, diagnose what the model lacks.

    Try it without hardware: mbcacq run kuka --dry-run
    """
    if context.invoked_subcommand is None:
        echo(FIRST)
