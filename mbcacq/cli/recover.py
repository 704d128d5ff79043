"""``mbcacq recover``: make a torn recording readable."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.run_path import RunPath
from mbcacq.cli.terminal import echo


@click.command("recover")
@click.argument("recording", type=RunPath())
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(recording: Path, as_json: bool) -> None:
    """Make RECORDING (a run folder or a .rrd file) readable after a crash, a power cut or a full disk.

    Everything complete before the tear goes into a copy, NAME.recovered.rrd; the original is not touched. All commands that
    take a run folder use the copy from then on.
    """
    from mbcacq.cli.signals import end_in_order_on_signals
    from mbcacq.recording.run_folder.recovery import recover

    end_in_order_on_signals("the recovery")
    found = recover(recording)
    if as_json:
        echo(
            json.dumps(
                {
                    "recordings": [
                        {
                            "source": str(item.source),
                            "output": str(item.output),
                            "damaged": item.damaged,
                            "poses": item.poses,
                            "cycles": item.cycles,
                            "complete": item.complete,
                        }
                        for item in found
                    ]
                }
            )
        )
        return
    for item in found:
        content = f"{item.poses} finished poses, {item.cycles} controller cycles"
        end = "" if item.complete else "; the run did not come to its end"
        if item.damaged:
            echo(f"{item.source}: torn; {content} are in {item.output}{end}")
        else:
            echo(f"{item.source}: nothing to do, {content}{end}")
