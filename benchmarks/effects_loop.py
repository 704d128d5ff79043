"""What a diagnosis finds comes back: a cell with concealed compliance and gear errors, calibrated with and without what was found.

    python benchmarks/effects_loop.py [--plan plans/kuka-effects.yaml] [--seeds 3] [--protocols]

For each seed a fake cell conceals an elastic A2 and A3 and a wavy A4. It is recorded (by arrays; with --protocols through its servers),
calibrated as geometry, diagnosed, and calibrated with the effects. Printed are sphere spacing errors of the bar, which took part in no
fit; the centres of a second run of the same cell at other poses, predicted by the simulation with everything held (chi2 per degree of
freedom under the stated noise); and the same with geometry alone.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import mbcacq
from mbcacq.calibration.transfer import check_transfer
from mbcacq.calibration.verification import verification_poses
from mbcacq.challenge import simulated_cells
from mbcacq.challenge.scenarios import Scenario
from mbcacq.model.observations import Observations
from mbcacq.plan import expand

HIDDEN = [
    {"name": "joint_compliance", "where": "A2", "compliance_rad_per_Nm": 2.0e-6},
    {"name": "joint_compliance", "where": "A3", "compliance_rad_per_Nm": 3.0e-6},
    {"name": "gear_transmission_error", "where": "A4", "order": 2.0, "amplitude_deg": 0.01, "phase_deg": 40.0},
]


def recorded(plan: Path, seed: int, protocols: bool, shifted: bool) -> Observations:
    """One run of the concealed cell; shifted: at other joint angles, up to 3 deg away."""
    loaded = mbcacq.load_plan(plan)
    poses = expand(loaded)
    if shifted:
        rng = np.random.default_rng(seed + 1000)
        poses = [replace(p, q=np.clip(p.q + rng.uniform(-0.05, 0.05, len(p.q)), *loaded.cell.robot.limits.T)) for p in poses]
    scenario = Scenario(seed, "two", seed, tuple(h["name"] for h in HIDDEN), seed, 1.0)
    if not protocols or shifted:
        return simulated_cells.observe(loaded, poses, scenario, HIDDEN)[0]
    with tempfile.TemporaryDirectory() as folder:
        return simulated_cells.run(loaded, poses, scenario, HIDDEN, Path(folder) / "run")[0]


def study(plan: Path, seed: int, protocols: bool) -> list[str]:
    """The row of one seed."""
    first, second = (recorded(plan, seed, protocols, shifted) for shifted in (False, True))
    fit = first.select(first.phase != "verification")
    options = mbcacq.CalibrationOptions(refuse=False)
    alone = mbcacq.calibrate(first, options)
    found = mbcacq.diagnose(fit, workers=1)
    names = "; ".join(f"{e.name} {'+'.join(e.where)}" for e in found.effects) or "none"
    if found.model is None:
        return [str(seed), names, "", "", "", "", "", ""]
    cell = mbcacq.calibrate(first, options, effects=found)
    bars = verification_poses(first)
    spacing = [float(np.abs(mbcacq.verify(bars, c).errors("after")).mean()) for c in (alone, cell)]
    expected = mbcacq.verify(bars, cell).to_dict() or {}
    other = second.select(second.phase != "verification")
    other = replace(other, pose_id=other.pose_id + 10_000)
    known = check_transfer(other, cell, alone.state.chain, place="known")
    return [
        str(seed),
        names,
        f"{spacing[0]:.4f}",
        f"{spacing[1]:.4f}",
        f"{expected.get('expected_mean_mm', float('nan')):.4f}",
        f"{known.geometry_alone.rms_mm:.4f}",
        f"{known.with_effects.rms_mm:.4f}",
        f"{known.with_effects.chi2_dof:.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plan", type=Path, default=Path("plans/kuka-effects.yaml"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--protocols", action="store_true")
    given = parser.parse_args()
    header = ("seed", "found", "bar, geometry mm", "effects mm", "expected mm", "2nd run, geometry mm", "effects mm", "chi2/dof")
    print("| " + " | ".join(header) + " |")
    print("|---|---|---|---|---|---|---|---|")
    for seed in range(1, given.seeds + 1):
        print("| " + " | ".join(study(given.plan, seed, given.protocols)) + " |", flush=True)


if __name__ == "__main__":
    main()
