"""Everything that is printed goes through here: what foreign data could tell the terminal to do is shown as text instead.

Names of devices, files and stations come from outside, and an escape sequence in one of them could clear the screen, set its title or
hide what follows.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Collection, Iterable
from textwrap import TextWrapper
from typing import IO, TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

# Control characters but tab and line feed; marks that turn the direction of text; halves of characters, of undecodable file names.
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


# How quantities are written where the terminal has no such character.
LETTERS = dict(zip("µ±°·×–χ²θαβ", "u,+-, deg,*,x,-,chi,2,theta,alpha,beta".split(","), strict=True)) | {
    sign: f"{'^' if sign == '⁻' else ''}{plain}" for sign, plain in zip("⁻⁰¹³⁴⁵⁶⁷⁸⁹", "-013456789", strict=True)
}


def printable(text: str) -> str:
    """The text with each unsafe character as its escape (``\\x1b``); what is printable already stays as it is."""
    return _UNSAFE.sub(lambda found: ascii(found.group())[1:-1], text)


def echo(text: str = "", err: bool = False, nl: bool = True, label: tuple[str, str] | None = None, whole: str = "") -> None:
    """Print a line of our own words and foreign data, on a terminal of any encoding. label: a word in front, and its colour, which only a
    terminal shows, and none where NO_COLOR is set; whole: the end of the line, which is never broken, such as a command to be pasted."""
    stream = sys.stderr if err else sys.stdout
    first = "" if label is None else click.style(printable(label[0]), fg=label[1])
    shown = _encodable(printable(text), stream)
    unbroken = _encodable(printable(whole), stream)
    if nl and stream.isatty():
        columns = shutil.get_terminal_size().columns
        shown = wrapped(shown, columns, 0 if label is None else len(label[0]))
        if unbroken and len(shown) + 1 + len(unbroken) > columns:
            shown, unbroken = f"{shown}\n", f"  {unbroken}"
    shown += f" {unbroken}" if unbroken and not shown.endswith("\n") else unbroken
    click.echo(first + shown, err=err, nl=nl, color=False if os.environ.get("NO_COLOR") else None)


def wrapped(text: str, columns: int, taken: int = 0) -> str:
    """Lines of at most so many columns, broken between words; what goes on is indented as far as its line, and two more. taken: columns
    of the first line that stand already. A path or a word that is longer stays whole."""
    out = []
    for k, line in enumerate(text.split("\n")):
        room, own = taken if k == 0 else 0, " " * (len(line) - len(line.lstrip()))
        filler = TextWrapper(columns, " " * room + own, own + "  ", False, False, break_long_words=False, break_on_hyphens=False)
        out.append(line if room + len(line) <= columns else filler.fill(line.lstrip())[room:])
    return "\n".join(out)


def console(**options: Any) -> Console:
    """A rich console for tables and bars, without markup in the texts that it is given."""
    from rich import console as rich
    from rich.segment import Segment

    class SafeConsole(rich.Console):
        def render(self, renderable: rich.RenderableType, options: rich.ConsoleOptions | None = None) -> Iterable[Segment]:
            for segment in super().render(renderable, options):
                text, style, control = segment
                yield segment if control else Segment(_encodable(printable(text), self.file), style)

    shown = SafeConsole(markup=False, emoji=False, **options)
    if shown.is_terminal:
        shown.soft_wrap = False  # long lines are broken between words, which a terminal would break anywhere
    return shown


def titled_table(title: str, *headings: str, left: Collection[str] = (), no_wrap: bool = False) -> Table:
    """A table with its title at the left. Columns of ``left`` hold words, the others numbers, which ``no_wrap`` keeps on one line."""
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in left else "right", no_wrap=no_wrap and heading not in left)
    return table


def _encodable(text: str, stream: IO[str]) -> str:
    """A minus as the hyphen that other programs read; symbols that the stream's encoding lacks in letters, anything else as escapes."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    text = text.replace("−", "-")
    try:
        return text.encode(encoding).decode(encoding)
    except UnicodeEncodeError:
        plain = "".join(c if _has(encoding, c) else LETTERS.get(c, c) for c in text)
        return plain.encode(encoding, "backslashreplace").decode(encoding)


def _has(encoding: str, character: str) -> bool:
    try:
        character.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True
