"""What is wrong or doubtful in a plan, found before anything moves."""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq.plan import LoadedPlan, PlannedPose


def refuse_errors(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> None:
    pass
