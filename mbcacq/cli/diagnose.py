"""``mbcacq diagnose``: say where simulation and recording part, and what physics was left out."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command(name="diagnose")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--json",
    "json_file",
    type=click.Path(path_type=Path, dir_okay=False, allow_dash=True),
    is_flag=False,
    flag_value="-",
    help="Write the diagnosis as JSON to a file; without a file name, print it on stdout instead of the text.",
)
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), help="Write an HTML report with pictures.")
@click.option("--rrd", type=click.Path(path_type=Path, dir_okay=False), help="Write error arrows before and after as a rerun recording.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the proof (default: one for each processor core).")
def command(data: tuple[Path, ...], json_file: Path | None, report: Path | None, rrd: Path | None, workers: int | None) -> None:
    """Diagnose DATA: a run folder, an .rrd, an observation set; or one or several trajectory sets of one robot, together.

    In the folder of a run the diagnosis is kept (diagnosis.json, diagnosis.rrd): mbcacq report and mbcacq view show it from then on.

    \b
    Examples:
      mbcacq diagnose runs/today
      mbcacq diagnose ur5-tracker --report diagnosis.html --rrd diagnosis.rrd
    """
    from mbcacq.errors import ConfigError
    from mbcacq.recording.datasets.trajectory_set import is_trajectory_set

    if all(is_trajectory_set(folder) for folder in data):
        content, text = diagnose_in_time(data)
    elif len(data) > 1:
        raise ConfigError("several DATA can be diagnosed together only if all are trajectory sets; diagnose the others one by one")
    else:
        content, text = diagnose_poses(data[0], report, rrd, workers)
        content, text = beside_motion(data[0], content, text)
    print_diagnosis(content, text, json_file)


def diagnose_in_time(folders: tuple[Path, ...]) -> tuple[dict, str]:
    from mbcacq.diagnosis.motion import diagnose_trajectories
    from mbcacq.diagnosis.motion.text import motion_text
    from mbcacq.recording import read_trajectory_set

    diagnosis = diagnose_trajectories([read_trajectory_set(folder) for folder in folders])
    return diagnosis.to_json(), motion_text(diagnosis)


def diagnose_poses(data: Path, report: Path | None, rrd: Path | None, workers: int | None) -> tuple[dict, str]:
    from mbcacq.diagnosis.diagnose import diagnose
    from mbcacq.diagnosis.output.text import words
    from mbcacq.diagnosis.validation.workers import cores
    from mbcacq.recording import load_observations

    observations = load_observations(data)
    result = diagnose(observations, progress=lambda text: click.echo(f"{text} ...", err=True), workers=workers or cores())
    if report is not None:
        from mbcacq.workflow.diagnosis_files import write_html

        write_html(result, report)
    if rrd is not None:
        from mbcacq.workflow.diagnosis_files import write_rrd

        write_rrd(result, observations, rrd)
    if is_run(data):
        from mbcacq.workflow.diagnosis_files import keep_beside

        keep_beside(result, observations, data)
    return result.to_json(), words(result)


def beside_motion(data: Path, content: dict, text: str) -> tuple[dict, str]:
    """What the motion between the poses says, where a run recorded torques or joint-side angles; else the poses' diagnosis as it is."""
    from mbcacq.diagnosis.motion import combine, diagnose_trajectories
    from mbcacq.errors import ConfigError
    from mbcacq.model.trajectory import moves
    from mbcacq.recording.rrd.trajectory_recording import trajectory_of_run

    if not (is_run(data) or data.suffix == ".rrd"):
        return content, text
    try:
        trajectory = trajectory_of_run(data)
    except ConfigError:
        return content, text
    stretches = moves(trajectory) if trajectory.torque is not None or trajectory.q_joint is not None else []
    if not stretches:
        return content, text
    click.echo("comparing the motion between the poses ...", err=True)
    motion = diagnose_trajectories(stretches)
    return combine.combined(content, motion), combine.combined_text(content, text, motion)


def is_run(data: Path) -> bool:
    """Whether DATA is the folder of a run, where the diagnosis is kept beside the recording."""
    from mbcacq.recording.rrd import layout

    return data.is_dir() and bool(layout.parts(data))


def print_diagnosis(content: dict, text: str, json_file: Path | None) -> None:
    as_json = json.dumps(content, indent=1, allow_nan=False)
    if json_file is not None and str(json_file) == "-":
        click.echo(as_json)
        return
    if json_file is not None:
        json_file.write_text(as_json + "\n", encoding="utf-8")
    click.echo(text)
