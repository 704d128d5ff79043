"""``mbcacq drivers``: what is installed."""

from __future__ import annotations

import json

import click

from mbcacq.devices import available

KINDS = ("robots", "scanners", "positioners", "sensors", "fakes")


@click.command("drivers")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(as_json: bool) -> None:
    """List the installed drivers by kind, and where each comes from."""
    found = {kind: available(kind) for kind in KINDS}
    if as_json:
        click.echo(json.dumps(found))
        return
    for kind, drivers in found.items():
        for name, target in sorted(drivers.items()):
            click.echo(f"{kind:12} {name:12} {target}")
