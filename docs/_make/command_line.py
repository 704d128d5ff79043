"""The command line, from the commands themselves."""

from __future__ import annotations

import inspect

import click

from mbcacq.cli.app import COMMANDS, app
from mbcacq.errors import EXIT_CODE_MEANING, ExitCode


def command_line() -> str:
    """Markdown of every command with its arguments, options and defaults, and of the exit codes."""
    out = ["# Command line", "", "Made from the commands; `mbcacq COMMAND --help` prints the same.", ""]
    root = click.Context(app, info_name="mbcacq")
    for name in COMMANDS:
        out += section(app.get_command(root, name), root, name)
    out += ["## Exit codes", "", "| code | meaning |", "|--:|---|"]
    out += [f"| {code.value} | {EXIT_CODE_MEANING[code]} |" for code in ExitCode]
    return "\n".join(out) + "\n"


def section(command: click.Command, above: click.Context, name: str) -> list[str]:
    """One command; a group is followed by its own commands."""
    context = click.Context(command, info_name=name, parent=above)
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    level = "#" * len(context.command_path.split())
    out = [f"{level} {context.command_path}", "", "```text", usage, "```", "", inspect.cleandoc(command.help or "").replace("\b\n", ""), ""]
    options = [p for p in command.params if isinstance(p, click.Option) and not p.hidden]
    if options:
        out += ["| option | |", "|---|---|"]
        out += [f"| `{spelled(option)}` | {described(option)} |" for option in options]
        out.append("")
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            out += section(command.get_command(context, each), context, each)
    return out


def spelled(option: click.Option) -> str:
    names = ", ".join([*option.opts, *option.secondary_opts])
    if option.is_flag or option.count:
        return names
    return f"{names} {option.make_metavar(click.Context(click.Command('x')))}".replace("|", r"\|")


def described(option: click.Option) -> str:
    text = (option.help or "").replace("|", r"\|")
    shown = option.show_default and option.default is not None and not option.is_flag
    return f"{text} [default: {option.default}]" if shown else text
