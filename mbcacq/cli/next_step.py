"""What to do next, in one line after a command, as a person who knows the tool would say it; on stderr, and not for programs."""

from __future__ import annotations

from mbcacq.cli.terminal import echo

_after_failure: list[str] = []


def say_next(what: str, command: str = "") -> None:
    """Print the next step. what: in words; command: that does it, or ''."""
    echo(f"next: {what[:1].lower()}{what[1:]}" + (f": {command}" if command else ""), err=True)


def on_failure(what: str, command: str) -> None:
    """Keep the next step for the case that the command fails or is interrupted: it is then the last line that is printed."""
    _after_failure[:] = [f"next: {what}: {command}"]


def forget_failure() -> None:
    """Nothing is to be said any more if the command fails from here on."""
    _after_failure.clear()


def say_after_failure() -> None:
    """Print what ``on_failure`` kept, once."""
    for line in _after_failure:
        echo(line, err=True)
    _after_failure.clear()
