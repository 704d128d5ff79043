"""The fake cell of a dry run: it speaks the devices' protocols on this computer."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from mbcacq.acquisition.cell_devices import Overrides, create_devices
from mbcacq.devices import load_driver
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose


@dataclass(frozen=True)
class MeasuredBefore:
    """The earlier measurements in a fake cell that is started again. time_s: the robot's clock at the last pose, None before the first one;
    poses: how many.
    """

    time_s: float | None = None
    poses: int = 0

    @classmethod
    def of(cls, obs: Observations, numbers: Collection[int]) -> MeasuredBefore:
        """The poses of these numbers, as far as they are recorded."""
        here = np.isin(obs.pose_id, list(numbers))
        if obs.time_s is None or not here.any():
            return cls(None, int(here.sum()))
        return cls(float(obs.time_s[here].max()), int(here.sum()))


@contextmanager
def device_overrides(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], dry_run: bool, seed: int, assume_yes: bool, before: MeasuredBefore | None = None
) -> Iterator[Overrides]:
    """Options that replace the plan's own by device. They are the fake cell's addresses in a dry run, while the fake cell is up, and the
    answer yes to the prompts of a person who moves the artefacts. before: what a run that goes on has measured in the same cell.

    Raises ConfigError if a driver cannot be imported or refuses its options: before a folder is made, a device opened.
    """
    yes = {"assume_yes": True} if assume_yes and loaded.plan.positioner.driver == "manual" else {}
    if not dry_run:
        overrides = {"positioner": yes} if yes else {}
        create_devices(loaded, overrides)
        yield overrides
        return
    before = before or MeasuredBefore()
    with load_driver("fakes", "cell")(
        loaded, poses, realtime=False, seed=seed, first_poses=loaded.grown_from, resumed_at_s=before.time_s, poses_before=before.poses
    ) as fake:
        overrides = fake.overrides()
        if yes:
            overrides = {**overrides, "positioner": {**overrides.get("positioner", {}), **yes}}
        create_devices(loaded, overrides)
        yield overrides


def name_of(dry_run: bool, seed: int) -> str:
    """Which cell is driven, in words; a resumed run stays with it."""
    return f"the fake cell of seed {seed}" if dry_run else "the plan's own devices"
