"""``mbcacq diagnose``: say where simulation and recording part, and what physics was left out."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command(name="diagnose")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False, allow_dash=True), is_flag=False, flag_value="-",
              help="Write the diagnosis as JSON to a file; without a file name, print it on stdout instead of the text.")
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), help="Write an HTML report with pictures.")
@click.option("--rrd", type=click.Path(path_type=Path, dir_okay=False), help="Write error arrows before and after as a rerun recording.")
def command(data: tuple[Path, ...], json_file: Path | None, report: Path | None, rrd: Path | None) -> None:
    """Diagnose DATA: a run folder, an .rrd, an observation set; or one or several trajectory sets of one robot, together."""
    from mbcacq.errors import ConfigError
    from mbcacq.recording.trajectory import is_trajectory_set

    if all(is_trajectory_set(folder) for folder in data):
        content, text = diagnose_in_time(data)
    elif len(data) > 1:
        raise ConfigError("several DATA can be diagnosed together only if all are trajectory sets; diagnose the others one by one")
    else:
        content, text = diagnose_poses(data[0], report, rrd)
    print_diagnosis(content, text, json_file)


def diagnose_in_time(folders: tuple[Path, ...]) -> tuple[dict, str]:
    from mbcacq.diagnosis.trajectory import diagnose_trajectories
    from mbcacq.diagnosis.trajectory.text import trajectory_words
    from mbcacq.recording import read_trajectory_set

    content = diagnose_trajectories([read_trajectory_set(folder) for folder in folders])
    return content, trajectory_words(content)


def diagnose_poses(data: Path, report: Path | None, rrd: Path | None) -> tuple[dict, str]:
    from mbcacq.diagnosis.diagnose import diagnose
    from mbcacq.diagnosis.text import words
    from mbcacq.recording import load

    observations = load(data)
    result = diagnose(observations, progress=lambda text: click.echo(f"{text} ...", err=True))
    if report is not None:
        from mbcacq.diagnosis.figures import write_html

        write_html(result, result.evidence, report)
    if rrd is not None:
        from mbcacq.diagnosis.figures import write_rrd

        write_rrd(result.evidence, rrd)
    return result.as_json(), words(result)


def print_diagnosis(content: dict, text: str, json_file: Path | None) -> None:
    as_json = json.dumps(content, indent=1, allow_nan=False)
    if json_file is not None and str(json_file) == "-":
        click.echo(as_json)
        return
    if json_file is not None:
        json_file.write_text(as_json + "\n", encoding="utf-8")
    click.echo(text)
