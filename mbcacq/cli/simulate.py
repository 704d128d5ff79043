"""``mbcacq simulate``: the twin of a cell, as an observation set; or of an arm in motion, as a trajectory set."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.errors import ConfigError


@click.command("simulate")
@click.argument("plan", type=click.Path(path_type=Path))
@click.option(
    "--cell", "result", type=click.Path(path_type=Path), help="Calibrated cell: a result.json, or a run folder with one [default: nominal]."
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the observation set to write.")
@click.option("--noise", is_flag=True, help="Add the scatter of scanner and joints; without it the set holds the model's exact prediction.")
@click.option("--seed", default=0, show_default=True, help="Seed of that scatter.")
@click.option("--force", is_flag=True, help="Replace an observation set that is there.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as one JSON object on stdout.")
def command(plan: Path, result: Path | None, out: Path, noise: bool, seed: int, force: bool, as_json: bool) -> None:
    """Write what the calibrated model says PLAN would record, as an observation set; or, for a trajectory set in PLAN's place, what an
    ideal arm would have recorded along that motion.

    \b
    Examples:
      mbcacq simulate plans/kuka.yaml --out twin/                           the nominal cell
      mbcacq simulate plans/kuka.yaml --cell runs/today --out twin/         the cell as calibrated today
      mbcacq simulate plans/kuka.yaml --cell runs/today --noise --out twin/   and with its noise
      mbcacq simulate recorded-motion/ --out twin/                          set points, joint-side angles and torques of a rigid arm
    """
    from mbcacq.plan import expand, load, refuse_errors
    from mbcacq.recording import write_observation_set
    from mbcacq.recording.datasets.trajectory_set import is_trajectory_set, read_trajectory_set, write_trajectory_set
    from mbcacq.workflow.simulate import simulate, simulate_motion

    if (out / "cell.yaml").exists() and not force:
        raise ConfigError(f"{out} already holds an observation set; give another --out, or --force to replace it")
    if is_trajectory_set(plan):
        if result is not None or noise:
            raise ConfigError(f"{plan} is a trajectory set: --cell and --noise are for plans; leave them out")
        motion = simulate_motion(read_trajectory_set(plan))
        write_trajectory_set(motion, out)
        told = {"format": "mbcacq-simulation/1", "folder": str(out), "samples": len(motion.time_s)}
        click.echo(json.dumps(told) if as_json else f"{len(motion.time_s)} samples written to {out}")
        return
    loaded = load(plan)
    poses = expand(loaded)
    refuse_errors(loaded, poses)
    observations = simulate(loaded, poses, None if result is None else read_result(result), noise, seed)
    write_observation_set(observations, out)
    if as_json:
        click.echo(
            json.dumps(
                {
                    "format": "mbcacq-simulation/1",
                    "folder": str(out),
                    "poses": observations.n_poses,
                    "centres": observations.n_centres,
                    "noise": noise,
                }
            )
        )
    else:
        click.echo(f"{observations.n_poses} poses, {observations.n_centres} ball centres written to {out}")


def read_result(path: Path) -> dict:
    """The content of a result.json, given itself or by its run folder. Raises ConfigError."""
    file = path / "result.json" if path.is_dir() else path
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read {file}: {error.strerror}; give the result.json of a calibration") from error
    except (ValueError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file} is not JSON ({error}); give the result.json of a calibration") from error
