"""A plan from nothing, for an arm, a scanner and an artefact."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mbcacq.design.new_plan import NewPlan, NewPlanOptions, write_new_plan
from mbcacq.errors import ConfigError
from mbcacq.model import shipped
from mbcacq.plan import LoadedPlan
from mbcacq.workflow.load import load_plan


def new_plan(
    robot: Path | str,
    scanner: Path | str,
    artefact: Path | str,
    out: Path | str = "plan.yaml",
    options: NewPlanOptions | None = None,
    *,
    force: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> LoadedPlan:
    """Write a plan with stations and views that this arm reaches, the scanner sees and the calibration learns from.

    Parameters
    ----------
    robot, scanner, artefact
        Names of files that come with mbcacq (``kr6_r900_2``, ``gocator-3210``, ``mbc-8``), or files. A scanner file holds ``scanner`` and
        ``hand_eye`` as in a plan.
    out
        The file to write.
    options
        Driver, numbers of stations and poses, seed.
    force
        Replace a file that exists.
    progress
        Called with a sentence for each step and for what was made.

    Returns
    -------
    LoadedPlan
        The new plan.

    Raises
    ------
    ConfigError
        ``out`` exists (without ``force``), the files do not fit, or the arm serves too few places.
    """
    path = Path(out)
    if path.exists() and not force:
        raise ConfigError(f"{path} exists already; give another --out, or --force to replace it")
    robot_file, scanner_file, artefact_file = (
        shipped.named_file(kind, str(name)) for kind, name in (("robots", robot), ("scanners", scanner), ("artefacts", artefact))
    )
    for sentence in write_new_plan(NewPlan(robot_file, scanner_file, artefact_file, path, options or NewPlanOptions()), progress):
        progress(sentence)
    return load_plan(path)
