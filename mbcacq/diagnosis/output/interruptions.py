"""Pauses of a recording, and what happened to the temperatures across them: explanations of a sudden change that no pose can tell apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.model.observations import Observations

LONG = 10.0  # times the median time from pose to pose
LEAST_S = 900.0  # shorter is no pause
LEAST_C = 0.5  # change of a temperature worth saying
CHANGES = ("joint_step", "mount_shift", "station_drift", "thermal_growth", "scanner_warmup")


@dataclass(frozen=True)
class Interruption:
    """after, before: numbers of the poses on either side; temperatures: name -> values on either side (deg C)."""

    seconds: float
    after: int
    before: int
    temperatures: dict[str, tuple[float, float]]

    def __str__(self) -> str:
        hours = f"{self.seconds / 3600:.1f} h" if self.seconds > 5400 else f"{self.seconds / 60:.0f} min"
        changes = (f"{name} went from {a:.1f} to {b:.1f} deg C" for name, (a, b) in self.temperatures.items())
        return ", ".join([f"a pause of {hours} after pose {self.after}", *changes])


def pauses(obs: Observations) -> list[Interruption]:
    """Interruptions much longer than the usual time from pose to pose."""
    if obs.time_s is None or obs.n_poses < 3:
        return []
    order = np.argsort(obs.time_s, kind="stable")
    gap = np.diff(obs.time_s[order])
    out = []
    for j in np.flatnonzero(gap > max(LONG * float(np.median(gap)), LEAST_S)):
        a, b = order[j], order[j + 1]
        changed = {name: (float(T[a]), float(T[b])) for name, T in obs.temperatures.items() if abs(T[b] - T[a]) > LEAST_C}
        out.append(Interruption(float(gap[j]), int(obs.pose_id[a]), int(obs.pose_id[b]), changed))
    return out


def confounded(obs: Observations, names: set[str], moments: list[tuple[float, float]]) -> list[str]:
    """Sentences on pauses. names: of the effects found; moments: pose numbers of sudden changes, with their uncertainty."""
    out = []
    rank = {int(n): r for r, n in enumerate(obs.pose_id[np.argsort(obs.time_s, kind="stable")])} if obs.time_s is not None else {}
    for pause in pauses(obs):
        near = [m for m, std in moments if abs(rank.get(round(m), -(10**9)) - rank[pause.before]) <= max(2 * std, 5.0)]
        if near:
            out.append(
                f"there is {pause}: the change at pose {near[0]:.0f} may be a displacement, thermal growth or a new mastering meanwhile, "
                "which these data cannot tell apart"
            )
        elif names & set(CHANGES):
            out.append(f"there is {pause}")
    return out
