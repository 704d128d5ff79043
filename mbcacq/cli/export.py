"""``mbcacq export``: recordings and results in the formats of other programs."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.result_options import result_options


@click.command("export")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--observations", type=click.Path(path_type=Path, file_okay=False), help="Write an observation set (YAML, CSV) there.")
@click.option("--scans", is_flag=True, help="With --observations: the raw clouds as well (scans/POSE.ply, first exposure of each pose).")
@click.option("--trajectory", type=click.Path(path_type=Path, file_okay=False), help="Write the controller cycles as a trajectory set.")
@click.option("--force", is_flag=True, help="Replace what is already there.")
@result_options
@click.option("--json", "as_json", is_flag=True, help="Print what was written as one JSON object on stdout.")
def command(run: Path, observations: Path | None, scans: bool, trajectory: Path | None, force: bool, as_json: bool, **results) -> None:
    """Write RUN (a run folder, a .rrd file or an observation set) in the formats of other programs."""
    from mbcacq.errors import ConfigError
    from mbcacq.exports.export_results import export_results
    from mbcacq.recording import load_observations

    written = export_results(run, force=force, **results)
    if observations is None and trajectory is None and not written:
        raise ConfigError("nothing to export; say what and where, such as --observations DIR or --results DIR")
    for folder in (observations, trajectory):
        if folder is not None and (folder / "cell.yaml").exists() and not force:
            raise ConfigError(f"{folder} already holds a set; give another folder, or --force to replace it")
    if observations is not None:
        from mbcacq.recording.datasets.observation_set import write_observation_set

        measured = load_observations(run)
        write_observation_set(measured, observations)
        written.append({"file": str(observations), "poses": measured.n_poses, "centres": measured.n_centres})
        if scans:
            from mbcacq.recording.rrd.scan_export import write_scans

            written.append({"file": str(observations / "scans"), "clouds": write_scans(run, observations)})
    if trajectory is not None:
        from mbcacq.recording.rrd.trajectory_recording import export_trajectory

        written.append({"file": str(trajectory), "samples": export_trajectory(run, trajectory)})
    if as_json:
        click.echo(json.dumps({"format": "mbcacq-export/1", "written": written}))
        return
    for one in written:
        more = ", ".join(f"uncertainty {v:.4f} mm (k = 1)" if k == "uncertainty_mm" else f"{v} {k}" for k, v in one.items() if k != "file")
        click.echo(one["file"] + (f": {more}" if more else ""))
