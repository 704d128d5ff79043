"""What a diagnosis finds comes back: a cell with concealed compliance and gear errors, calibrated with and without what was found.

    python benchmarks/effects_loop.py [--plan plans/kuka-effects.yaml] [--seeds 3] [--protocols] [--write]

For each seed a fake cell conceals an elastic A2 and A3 and a wavy A4. It is recorded (by arrays; with --protocols through its servers, with
clouds), calibrated as geometry, diagnosed, and calibrated with the effects. Printed are sphere spacing errors of the bar, which took part
in no fit, from measured centres and, with --protocols, from the clouds themselves brought into the base as ``mbcacq apply`` does; and the
centres of a second run of the same cell at other poses, with other noise, predicted by the simulation with everything held (chi2 per
degree of freedom under the stated noise). Beside it stands what noise alone leaves: the same of a run that conceals nothing, calibrated
as geometry.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import mbcacq
from mbcacq.calibration.transfer import TransferFigures, check_transfer
from mbcacq.calibration.verification import verification_poses
from mbcacq.challenge import simulated_cells
from mbcacq.challenge.scenarios import Scenario
from mbcacq.exports import clouds
from mbcacq.exports.scan_correction import place_scan
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations
from mbcacq.plan import expand
from mbcacq.recording.rrd.scan_export import write_scans

CAPTURE_MM = 1.0  # about a measured sphere, within which points of a cloud belong to it

HIDDEN = [
    {"name": "joint_compliance", "where": "A2", "compliance_rad_per_Nm": 2.0e-6},
    {"name": "joint_compliance", "where": "A3", "compliance_rad_per_Nm": 3.0e-6},
    {"name": "gear_transmission_error", "where": "A4", "order": 2.0, "amplitude_deg": 0.01, "phase_deg": 40.0},
]


def recorded(plan: Path, seed: int, folder: Path | None, shifted: bool = False, hidden: list[dict] = HIDDEN) -> Observations:
    """One run of the concealed cell, through its servers into a folder or by arrays; shifted: at other joint angles, up to 3 deg away, with
    other noise."""
    loaded = mbcacq.load_plan(plan)
    poses, noise_seed = expand(loaded), seed + 1000 if shifted else None
    if shifted:
        rng = np.random.default_rng(seed + 1000)
        poses = [replace(p, q=np.clip(p.q + rng.uniform(-0.05, 0.05, len(p.q)), *loaded.cell.robot.limits.T)) for p in poses]
    scenario = Scenario(seed, "two", seed, tuple(h["name"] for h in hidden), seed, 1.0)
    if folder is None:
        return simulated_cells.observe(loaded, poses, scenario, hidden, noise_seed=noise_seed)[0]
    return simulated_cells.run(loaded, poses, scenario, hidden, folder, noise_seed)[0]


def spacing_of_scans(run: Path, bars: Observations, cell: mbcacq.CalibratedCell, folder: Path) -> float:
    """Mean absolute sphere spacing error (mm) of the bars in clouds that were brought into the base as ``mbcacq apply`` does."""
    write_scans(run, folder)
    result = cell.to_dict()
    radius = dict(zip(bars.cell.ball_ids, np.concatenate([a.diameters for a in bars.cell.artefacts]) / 2, strict=True))
    certified = dict(zip(bars.cell.ball_ids, bars.cell.ball_centres, strict=True))
    ends: dict[int, dict[int, list[np.ndarray]]] = {}
    for m in range(bars.n_centres):
        pose, ball = int(bars.pose[m]), bars.cell.ball_ids[bars.ball[m]]
        points, _ = clouds.read(folder / "scans" / f"{int(bars.pose_id[pose])}.ply")
        near = points[np.abs(np.linalg.norm(points - bars.xyz[m], axis=1) - radius[ball]) < CAPTURE_MM]
        placed, _ = place_scan(result, bars.q[pose], near)
        ends.setdefault(int(bars.station[pose]), {}).setdefault(ball, []).append(centre_of(placed, radius[ball]))
    errors = []
    for balls in ends.values():
        if len(balls) == 2:
            (a, first), (b, second) = balls.items()
            length = np.linalg.norm(np.mean(first, axis=0) - np.mean(second, axis=0))
            errors.append(abs(length - np.linalg.norm(certified[a] - certified[b])))
    return float(np.mean(errors))


def centre_of(points: np.ndarray, radius: float) -> np.ndarray:
    """Centre (3,) of a sphere of known radius through points (N, 3), by least squares from the sphere of any radius."""
    A = np.c_[2 * points, np.ones(len(points))]
    start = np.linalg.lstsq(A, np.sum(points**2, axis=1), rcond=None)[0][:3]
    return least_squares(lambda c: np.linalg.norm(points - c, axis=1) - radius, start, loss="soft_l1", f_scale=0.03).x


def study(plan: Path, seed: int, protocols: bool) -> list[str]:
    """The row of one seed."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run = folder / "run" if protocols else None
        first, second = recorded(plan, seed, run), recorded(plan, seed, folder / "second" if protocols else None, shifted=True)
        fit = first.select(first.phase != "verification")
        options = mbcacq.CalibrationOptions(refuse=False)
        alone = mbcacq.calibrate(first, options)
        found = mbcacq.diagnose(fit, workers=1)
        names = "; ".join(f"{e.name} {'+'.join(e.where)}" for e in found.effects) or "none"
        if found.model is None:
            return [str(seed), names, *[""] * 11]
        cell = mbcacq.calibrate(first, options, effects=found)
        bars = verification_poses(first)
        spacing = [float(np.abs(mbcacq.verify(bars, c).errors("after")).mean()) for c in (alone, cell)]
        scans = ["", ""]
        if run is not None:
            scans = [f"{spacing_of_scans(run, bars, c, folder):.4f}" for c in (alone, cell)]
        expected = mbcacq.verify(bars, cell).to_dict() or {}
        noise = by_noise_alone(plan, seed, folder / "noise" if protocols else None, options)
        geometry, with_effects = predicted(second, cell, alone.state.chain)
    return [
        str(seed),
        names,
        f"{spacing[0]:.4f}",
        f"{spacing[1]:.4f}",
        *scans,
        f"{expected.get('expected_mean_mm', float('nan')):.4f}",
        *noise[:2],
        f"{geometry.rms_mm:.4f}",
        f"{with_effects.rms_mm:.4f}",
        f"{with_effects.chi2_dof:.2f}",
        noise[2],
    ]


def by_noise_alone(plan: Path, seed: int, folder: Path | None, options: mbcacq.CalibrationOptions) -> list[str]:
    """What noise leaves where nothing is concealed and geometry is calibrated: of the bar, from centres and from clouds; and chi2 per
    degree of freedom of a second run, which the uncertainty of the calibration is in as well.
    """
    calm = recorded(plan, seed, folder, hidden=[])
    cell = mbcacq.calibrate(calm, options)
    bars = verification_poses(calm)
    centres = float(np.abs(mbcacq.verify(bars, cell).errors("after")).mean())
    scans = "" if folder is None else f"{spacing_of_scans(folder, bars, cell, folder / 'scans'):.4f}"
    second = recorded(plan, seed, None if folder is None else folder / "second", shifted=True, hidden=[])
    return [f"{centres:.4f}", scans, f"{predicted(second, cell, cell.state.chain)[1].chi2_dof:.2f}"]


def predicted(second: Observations, cell: mbcacq.CalibratedCell, alone: Chain) -> tuple[TransferFigures, TransferFigures]:
    """What a calibrated cell leaves of a second run with nothing fitted: by the geometry ``alone``, and with its effects."""
    other = second.select(second.phase != "verification")
    known = check_transfer(replace(other, pose_id=other.pose_id + 10_000), cell, alone, place="known")
    return known.geometry_alone, known.with_effects


HEADER = (
    "| seed | found | bar, geometry mm | with effects mm | clouds applied, geometry mm | with effects mm | expected mm | "
    "nothing concealed: bar mm | clouds applied mm | 2nd run, geometry mm | with effects mm | chi2/dof | "
    "nothing concealed: chi2/dof |"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plan", type=Path, default=Path("plans/kuka-effects.yaml"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--protocols", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into benchmarks/effects_loop.md")
    given = parser.parse_args()
    rows = [HEADER, "|---" * 13 + "|"]
    print(*rows, sep="\n", flush=True)
    for seed in range(1, given.seeds + 1):
        rows.append("| " + " | ".join(study(given.plan, seed, given.protocols)) + " |")
        print(rows[-1], flush=True)
    if given.write:
        mark = "protocols" if given.protocols else "arrays"
        page = Path(__file__).with_suffix(".md")
        before, _, after = page.read_text(encoding="utf-8").partition(f"<!-- {mark} -->\n")
        after = after.partition("<!-- end -->\n")[2]
        page.write_text(before + f"<!-- {mark} -->\n" + "\n".join(rows) + "\n<!-- end -->\n" + after, encoding="utf-8")


if __name__ == "__main__":
    main()
