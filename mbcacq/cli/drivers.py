"""``mbcacq drivers``: what is installed."""

from __future__ import annotations

import json

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.terminal import echo
from mbcacq.model.json_text import fields_as_json


@click.command("drivers")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(as_json: bool) -> None:
    """List the installed drivers: kind, name, the package each comes from, whether it can be used, whether it was tried on hardware.

    --json has the class of each too.
    """
    from mbcacq.devices.installed import survey

    found = list(survey())
    if as_json:
        echo(json.dumps({"format": "mbcacq-drivers/1", "drivers": [fields_as_json(driver) for driver in found]}))
        return
    rows = [("kind", "name", "package", "usable", "tried on hardware")]
    rows += [
        (
            d.kind,
            d.name,
            f"{d.package} {d.version}".strip(),
            "no" if d.problem else "yes",
            "-" if d.kind == "fakes" else d.tried or "not yet",
        )
        for d in found
    ]
    wide = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        echo("  ".join(f"{text:{width}}" for text, width in zip(row, wide, strict=True)).rstrip())
    for d in found:
        if d.problem:
            echo(f"{d.kind} {d.name} ({d.target}): {d.problem}")
    say_next("look whether this computer is ready for them", command_line("doctor"))
