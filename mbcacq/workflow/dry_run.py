"""The fake cell of a dry run: it speaks the devices' protocols on this computer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from mbcacq.acquisition.cell_devices import Overrides
from mbcacq.devices import load_driver
from mbcacq.plan import LoadedPlan, PlannedPose


@contextmanager
def device_overrides(loaded: LoadedPlan, poses: Sequence[PlannedPose], dry_run: bool, seed: int, assume_yes: bool) -> Iterator[Overrides]:
    """Options that replace the plan's own by device: the fake cell's addresses in a dry run, while the fake cell is up; and the answer yes
    to the prompts of a person who moves the artefacts."""
    yes = {"assume_yes": True} if assume_yes and loaded.plan.positioner.driver == "manual" else {}
    if not dry_run:
        yield {"positioner": yes} if yes else {}
        return
    with load_driver("fakes", "cell")(loaded, poses, realtime=False, seed=seed, first_poses=loaded.grown_from) as fake:
        overrides = fake.overrides()
        yield {**overrides, "positioner": {**overrides.get("positioner", {}), **yes}} if yes else overrides


def name_of(dry_run: bool, seed: int) -> str:
    """Which cell is driven, in words; a resumed run stays with it."""
    return f"the fake cell of seed {seed}" if dry_run else "the plan's own devices"
