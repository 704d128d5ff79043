"""Which part of an arm that was learnt in one recording errs in another one."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace

import numpy as np
from bench import HERE, put, table

import mbcacq
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.transfer import with_arm
from mbcacq.calibration.with_effects import some_poses
from mbcacq.effects.effect_term import COMMON_PATTERN
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import Estimate, build
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import system
from mbcacq.model.observations import Observations
from real_arms.transfer import learnt, some

POSES = 1500
BEGIN, AFTER = "<!-- causes -->\n", "<!-- end of causes -->"
ORDER, ARM = r"order (\d+)", r"(theta|d|a|alpha|beta)_\d$"
BANDS = {"orders 1 to 4 of the common pattern": (1, 4), "its orders 5 to 60": (5, 60)}


def what_errs(cell: CalibratedCell, other: Observations) -> dict[str, float]:
    """Rms (mm) of the positions in another recording if a part of the arm, base and tool are fitted there, by one linear step."""
    other = other.select(some_poses(other, POSES))
    other = with_arm(replace(other, pose_id=other.pose_id + 10**6), cell.state.chain)
    model = cell.effects
    assert model is not None, "effects were found"
    held = tuple(zip(model.at(other), model.coefficients, strict=True))
    placed = calibrate(other, CalibrationOptions(kinematics=False, discrepancy=False, balls=False, refuse=False, displaced=held))
    obs = replace(placed.fit.observations, rotation=None)
    at = {t.key: one for t, one in zip(model.terms, model.at(obs), strict=True)}
    pattern = next(t for t in model.terms if t.variant == COMMON_PATTERN)
    orders = tuple(f"order {1 + j % (pattern.k // 2)} {j}" for j in range(pattern.k))
    deviations = [t for t in model.terms if t is not pattern and t.parts[0].place == "joint" and t.k == pattern.k]
    own = {f"own errors of {t.where[0]}": t for t in deviations}
    terms = [replace(at[pattern.key], names=orders, sigma=np.full(pattern.k, np.inf))]
    for name, t in own.items():
        terms.append(replace(at[t.key], names=tuple(f"{name} {j}" for j in range(t.k)), sigma=np.full(t.k, np.inf)))
    options = replace(placed.fit.options, kinematics=True, random_links=False, terms=tuple(terms))
    options = replace(options, displaced=tuple(zip(at.values(), model.coefficients, strict=True)))
    lineariser = Lineariser(obs, build(obs, options), options)
    start = Estimate(placed.state, tuple(np.zeros(t.size) for t in terms))
    solution = system(lineariser, start, cell.noise, Weights(np.ones(obs.n_centres), np.ones(obs.n_poses)))
    names = list(lineariser.layout.names)
    chi2 = float(np.sum(solution.whitened_residual[:, :3] ** 2))
    rms = float(np.sqrt(np.mean(np.sum(solution.residual[:, :3] ** 2, axis=1))))

    def left(*wanted: str, band: tuple[int, int] = (0, 0)) -> float:
        free = [i for i, n in enumerate(names) if n.startswith("hand_eye") or any(re.match(one, n) for one in wanted)]
        found = {i: int(m[1]) for i, n in enumerate(names) if (m := re.match(ORDER, n))}
        index = np.array([*free, *(i for i, order in found.items() if band[0] <= order <= band[1])])
        A, b = solution.normal.information[np.ix_(index, index)], solution.normal.gradient[index]
        scale = 1 / np.sqrt(np.maximum(np.diag(A), 1e-300))
        step = scale * np.linalg.lstsq(A * scale[:, None] * scale, scale * b, rcond=1e-10)[0]
        return rms * float(np.sqrt(max(chi2 - 2 * b @ step + step @ A @ step, 0.0) / chi2))

    out = {"base and tool alone": left(), "geometry": left(ARM), "sideways offset d_4": left("d_4$")}
    out |= {name: left(band=band) for name, band in BANDS.items()}
    out |= {name: left(f"{name} ") for name in own if name[-2:] in ("A1", "A2")}
    return out | {"geometry and orders 5 to 60": left(ARM, band=(5, 60))}


def causes(given: argparse.Namespace) -> None:
    """Each campaign of the UR10 learnt, and what in it errs in the other."""
    campaigns = {name: some(mbcacq.load_observations(given.data / f"ur10-tracker-{name}"), given.poses) for name in "ac"}
    found = [what_errs(learnt(campaigns[here])[0], campaigns[there]) for here, there in ("ac", "ca")]
    rows = [[name, *(f"{one[name]:.3f}" for one in found)] for name in found[0] if all(name in one for one in found)]
    lines = "\n".join(table(["fitted to the checked campaign too", "A -> C mm", "C -> A mm"], rows))
    print(lines)
    if given.write:
        put(HERE / "transfer.md", lines, BEGIN, AFTER)
