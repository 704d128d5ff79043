"""What to do next, in one line after a command, as a person who knows the tool would say it; on stderr, and not for programs.

The command of such a line can be pasted: it is never broken, and words with spaces in them are quoted.
"""

from __future__ import annotations

from pathlib import Path

from mbcacq.cli.terminal import echo
from mbcacq.errors import MbcacqError
from mbcacq.errors import command_line as command_line

_after_failure: list[tuple[str, str, Path | None]] = []


def say_next(what: str, command: str) -> None:
    """Print the next step. what: in words; command: that does it."""
    echo(f"next: {what[:1].lower()}{what[1:]}:", err=True, whole=command)


def put_to_use(source: Path) -> tuple[str, str]:
    """What to do with a result in the end, and the command for it. source: its file, or the folder of it."""
    from mbcacq.calibration.result_io import export_command
    from mbcacq.exports.result_json import load_result

    try:
        result = load_result(source)
    except MbcacqError:
        result = {}
    return "put the result to use", export_command(result, source)


def on_failure(what: str, command: str, needs: Path | None = None) -> None:
    """Keep the next step for the case that the command fails or is interrupted: it is then the last line that is printed.

    needs: a file without which there is nothing to go on with, so that nothing is said.
    """
    _after_failure[:] = [(what, command, needs)]


def forget_failure() -> None:
    """Nothing is to be said any more if the command fails from here on."""
    _after_failure.clear()


def say_after_failure() -> None:
    """Print what ``on_failure`` kept, once."""
    for what, command, needs in _after_failure:
        if needs is None or needs.exists():
            say_next(what, command)
    _after_failure.clear()
