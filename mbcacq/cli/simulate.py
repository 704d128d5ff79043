"""``mbcacq simulate``: what a cell would record, as an observation set; or an arm in motion, as a trajectory set."""

from __future__ import annotations

from pathlib import Path

import mbcacq
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.errors import ConfigError
from mbcacq.recording.datasets import observation_set, trajectory_set
from mbcacq.workflow import simulate


@subcommand("simulate")
def command(
    plan: Path = argument(PlanPath()),
    result: Path | None = option("Calibrated cell: a result.json, or a run folder with one [default: nominal].", None, "--cell"),
    out: Path = option("Folder of the observation set to write.", required=True),
    noise: bool = option("Add the scatter of scanner and joints; without it the set holds the model's exact prediction."),
    seed: int = option("Seed of that scatter.", default=0),
    force: bool = option("Replace an observation set that is there."),
) -> Answer:
    """Write what PLAN would record by the calibrated model, as an observation set.

    PLAN may be a trajectory set: then what an ideal arm would have recorded along that motion is written.

    \b
    Examples:
      mbcacq simulate plans/kuka.yaml --out twin/            the nominal cell
      mbcacq simulate plans/kuka.yaml --cell runs/today --out twin/  as calibrated
      mbcacq simulate plans/kuka.yaml --cell runs/today --noise --out twin/
      mbcacq simulate recorded-motion/ --out twin/           a rigid arm, moving
    """
    if (out / "cell.yaml").exists() and not force:
        raise ConfigError(f"{out} already holds an observation set; give another --out, or --force to replace it")
    if trajectory_set.is_trajectory_set(plan):
        if result is not None or noise:
            raise ConfigError(f"{plan} is a trajectory set: --cell and --noise are for plans; leave them out")
        with StepProgress("computing what would be recorded"):
            samples = write_motion(plan, out)
        document = {"format": "mbcacq-simulation/1", "folder": str(out), "samples": samples}
        then = "compare the recording with it", command_line("diagnose", plan, "--simulation", out)
        return Answer(document, [f"{samples} samples written to {out}"], then)
    with StepProgress("computing what would be recorded"):
        observations = mbcacq.simulate(plan, result, noise=noise, seed=seed)
        observation_set.write_observation_set(observations, out)
    poses, centres = observations.n_poses, observations.n_centres
    document = {"format": "mbcacq-simulation/1", "folder": str(out), "poses": poses, "centres": centres, "noise": noise}
    then = "calibrate with it as with a recording", command_line("calibrate", out)
    return Answer(document, [f"{poses} poses, {centres} ball centres written to {out}"], then)


def write_motion(trajectory: Path, out: Path) -> int:
    """Write what an ideal arm would have recorded along the motion of a trajectory set; the number of samples."""
    (recorded,) = mbcacq.load_trajectories(trajectory)
    motion = simulate.simulate_motion(recorded)
    trajectory_set.write_trajectory_set(motion, out)
    return len(motion.time_s)
