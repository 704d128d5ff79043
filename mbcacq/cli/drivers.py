"""``mbcacq drivers``: what is installed."""

from __future__ import annotations

from mbcacq.cli.declared import Answer, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.model.json_text import fields_as_json


@subcommand("drivers")
def command() -> Answer:
    """List the installed drivers: kind, name, the package each comes from, whether it can be used, whether it was tried on hardware.

    --json has the class of each too.
    """
    from mbcacq.devices.installed import survey

    found = list(survey())
    rows = [("kind", "name", "package", "usable", "tried on hardware")]
    for d in found:
        usable, tried = "no" if d.problem else "yes", "-" if d.kind == "fakes" else d.tried or "not yet"
        rows.append((d.kind, d.name, f"{d.package} {d.version}".strip(), usable, tried))
    wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{text:{width}}" for text, width in zip(row, wide, strict=True)).rstrip() for row in rows]
    lines += [f"{d.kind} {d.name} ({d.target}): {d.problem}" for d in found if d.problem]
    document = {"format": "mbcacq-drivers/1", "drivers": [fields_as_json(driver) for driver in found]}
    return Answer(document, lines, ("look whether this computer is ready for them", command_line("doctor")))
