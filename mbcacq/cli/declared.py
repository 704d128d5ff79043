"""Commands that say each option once, and print their results in one way.

An option is the default value of a parameter of the command's function: the annotation is its type, the parameter's name its name.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

import click

from mbcacq.cli.next_step import say_next
from mbcacq.cli.terminal import console, echo

if TYPE_CHECKING:
    from rich.console import RenderableType

FILE, FOLDER = click.Path(path_type=Path, dir_okay=False), click.Path(path_type=Path, file_okay=False)


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a command says.

    Attributes
    ----------
    document
        The object of ``--json``, or its text.
    shown
        Lines and tables on standard output; a line with a word in front is (text, (word, its colour)).
    then
        What to do next, and the command for it.
    warnings, notes
        Lines on standard error that come before.
    wide
        Tables keep their width, however narrow the terminal is.
    end
        Called last. It may raise, for the exit code.
    """

    document: Mapping[str, Any] | str
    shown: Iterable[RenderableType | tuple[str, tuple[str, str]]] = ()
    then: tuple[str, str] | None = None
    warnings: Iterable[str] = ()
    notes: Iterable[str] = ()
    wide: bool = False
    end: Callable[[], object] = lambda: None

    def say(self, as_json: bool) -> None:
        """Print it."""
        if as_json:
            echo(self.document if isinstance(self.document, str) else json.dumps(self.document))
        else:
            for sentence in self.warnings:
                echo(f"*** {sentence} ***", err=True)
            for note in self.notes:
                echo(f"note: {note}", err=True)
            for one in self.shown:
                if isinstance(one, tuple):
                    echo(one[0], label=one[1])
                else:
                    echo(one) if isinstance(one, str) else console(highlight=False, soft_wrap=self.wide).print(one)
            if self.then is not None:
                say_next(*self.then)
        self.end()


@dataclasses.dataclass(frozen=True)
class _Declared:
    """An option or argument as it is declared, in the words of click."""

    kind: type[click.Parameter]
    names: tuple[str, ...]
    more: dict[str, Any]

    def __hash__(self) -> int:  # a dataclass takes it for a default value
        return id(self)


def option(help: str, kind: Any = None, *names: str, **more: Any) -> Any:
    """An option. kind: type of click or list of choices; None takes that of the annotation. names: where it has other names than its
    parameter. more: as of click."""
    return _Declared(click.Option, names, {"help": help, "type": click.Choice(kind) if isinstance(kind, list) else kind, **more})


def argument(kind: Any = None, **more: Any) -> Any:
    """An argument; as ``option``."""
    return _Declared(click.Argument, (), {"type": click.Choice(kind) if isinstance(kind, list) else kind, **more})


def subcommand(named: str, within: click.Group | None = None) -> Callable[[Callable[..., Answer | None]], click.Command]:
    """Decorator that makes a command of a function, in a group or by itself. A parameter whose default is a dataclass gets the options
    that the fields of that are, as one object. A command that returns an answer has the option ``--json``."""

    def decorated(function: Callable[..., Answer | None]) -> click.Command:
        accepted, kinds = inspect.signature(function).parameters, get_type_hints(function)
        groups = {name: p.default for name, p in accepted.items() if dataclasses.is_dataclass(p.default) and isinstance(p.default, type)}
        parameters: list[click.Parameter] = []
        for name, p in accepted.items():
            if name in groups:
                of_group = get_type_hints(groups[name])
                parameters += [_parameter(field.name, field.default, of_group[field.name]) for field in dataclasses.fields(groups[name])]
            elif isinstance(p.default, _Declared):
                parameters.append(_parameter(name, p.default, kinds[name]))
        answers = Answer in (kinds.get("return"), *get_args(kinds.get("return")))
        if answers:
            parameters.append(click.Option(["--json", "as_json"], is_flag=True, help="Print one JSON object on stdout."))

        @wraps(function)
        def called(as_json: bool = False, **given: Any) -> None:
            for key, group in groups.items():
                given[key] = group(**{field.name: given.pop(field.name) for field in dataclasses.fields(group)})
            if (answer := function(**given, **({"as_json": as_json} if "as_json" in accepted else {}))) is not None:
                answer.say(as_json)

        made = click.Command(named, params=parameters, callback=called, help=inspect.getdoc(function))
        if within is not None:
            within.add_command(made)
        return made

    return decorated


def _parameter(name: str, said: Any, annotation: Any) -> click.Parameter:
    parts = [part for part in get_args(annotation) if part is not type(None)] if isinstance(annotation, UnionType) else [annotation]
    several = get_origin(parts[0]) is tuple and get_args(parts[0])[-1] is ...
    plain = get_args(parts[0])[0] if several else parts[0]
    more = {key: value for key, value in said.more.items() if key != "type" or value is not None}
    if "type" not in more and plain in (int, float, str, Path):
        more["type"] = click.Path(path_type=Path) if plain is Path else plain
    if said.kind is click.Argument:
        return click.Argument([name], **{"nargs": -1 if several else 1, **more})
    if plain is bool:
        more |= {} if "default" in more or any("/" in each for each in said.names) else {"is_flag": True}
    elif several:
        more["multiple"] = True
    names = said.names or (f"--{name.replace('_', '-')}",)
    return click.Option([*names, name], show_default=more.get("default") is not None, **more)
