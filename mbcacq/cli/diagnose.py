"""``mbcacq diagnose``: say where simulation and recording part, and what physics was left out."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command(name="diagnose")
@click.argument("data", type=click.Path(path_type=Path))
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False, allow_dash=True), is_flag=False, flag_value="-",
              help="Write the diagnosis as JSON to a file; without a file name, print it on stdout instead of the text.")
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), help="Write an HTML report with pictures.")
@click.option("--rrd", type=click.Path(path_type=Path, dir_okay=False), help="Write error arrows before and after as a rerun recording.")
def command(data: Path, json_file: Path | None, report: Path | None, rrd: Path | None) -> None:
    """Diagnose DATA: a run folder, an .rrd, or an observation set."""
    from mbcacq.diagnosis.diagnose import diagnose
    from mbcacq.diagnosis.text import words
    from mbcacq.recording import load

    observations = load(data)
    result = diagnose(observations, progress=lambda text: click.echo(f"{text} ...", err=True))
    text = json.dumps(result.as_json(), indent=1, allow_nan=False)
    if json_file is not None and str(json_file) == "-":
        click.echo(text)
    else:
        if json_file is not None:
            json_file.write_text(text + "\n", encoding="utf-8")
        click.echo(words(result))
