"""Dry runs as short as their test allows: a shipped plan with a change, fewer poses, no calibration."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import yaml

PLANS = Path(__file__).resolve().parents[1] / "plans"


def plan_file(folder: Path, change: Callable[[dict], Any], name: str = "quick.yaml") -> Path:
    """A shipped plan with a change, its files named from where it now lies."""
    plan = yaml.safe_load((PLANS / name).read_text(encoding="utf-8"))
    plan["robot"]["model"] = str(PLANS / plan["robot"]["model"])
    plan["artefacts"] = [str(PLANS / a) for a in plan["artefacts"]]
    change(plan)
    path = folder / "plan.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False))
    return path


def few_views(plan: dict) -> None:
    """Where it matters that a run is whole, and not how much it measures: four poses, each seen once."""
    plan["exposures"] = 1
    plan["steps"] = [plan["steps"][1] | {"views": plan["steps"][1]["views"][:4]}]


def ur10(driver: str, options: dict) -> Callable[[dict], None]:
    """Few views of a UR10 with a driver of such arms, where that arm reaches the artefact."""

    def change(plan: dict) -> None:
        few_views(plan)
        plan["robot"] = {"driver": driver, "model": str(PLANS / "robots" / "ur10.yaml"), "options": options}
        plan["robot"]["home_deg"] = [0, -90, -90, -90, 90, 0]
        plan["stations"][0]["pose_in_base"] = {"translation_mm": [-800, -150, 200]}

    return change


def recorded(path: Path, folder: Path, subscribers: Iterable[Callable[[Any], None]] = ()):
    """What a dry run of a plan records, where the calibration and the report that follow say nothing about it. Returns observations."""
    from mbcacq.plan import expand, load
    from mbcacq.recording import load_observations
    from mbcacq.workflow.acquire import new_run_folder, plan_acquisition
    from mbcacq.workflow.dry_run import device_overrides

    loaded = load(path)
    poses = expand(loaded)
    run = plan_acquisition(loaded, poses, frozenset(), 0, "the fake cell of seed 0")
    run.folder = new_run_folder(folder, loaded.plan.name)
    with device_overrides(loaded, poses, dry_run=True, seed=0, assume_yes=True) as overrides:
        run.execute(overrides, subscribers)
    return load_observations(run.folder)
