"""Identifiability: directions of the parameters that the data leave undetermined are found, held and named, with their effect elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import computed_field

from mbcacq.errors import CalibrationError
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import UNDETERMINED, Estimate, ParameterLayout
from mbcacq.estimation.solution import Solution, system
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations

VISIBLE_MM = 0.05  # effect of a plausible change somewhere in the workspace below which leaving it out does no harm
PROBES = 300


@dataclass(frozen=True)
class Undetermined:
    """A direction of the parameters that the data do not determine. name: the parameter held for it; together: others that take part;
    effect_mm: what a plausible change of it would do to a measured point elsewhere in the workspace (rms)."""

    name: str
    together: tuple[str, ...]
    effect_mm: float

    @computed_field
    @property
    def harmless(self) -> bool:
        """Too small to matter."""
        return self.effect_mm < VISIBLE_MM

    @property
    def reason(self) -> str:
        alone = f"not determined by these poses{' together with ' + ', '.join(self.together) if self.together else ''}"
        return f"{alone}; without effect on what is measured" if self.harmless else alone


def determined(obs: Observations, options: CalibrationOptions, start: Estimate, noise: Noise | None) -> tuple[Solution, list[Undetermined]]:
    """The system at a start, with what the data leave undetermined held; under the stated noise if none is given.

    Raises CalibrationError if that would matter elsewhere in the workspace, unless ``options.refuse`` is off.
    """
    layout = parameters.build(obs, options)
    lineariser = Lineariser(obs, layout, options)
    at = system(lineariser, start, lineariser.first_noise if noise is None else noise, lineariser.everything)
    layout, found = hold_undetermined(at)
    return (system(lineariser.with_layout(layout), start, at.noise, at.weights) if found else at), found


def still_determined(at: Solution) -> tuple[Solution, list[Undetermined]]:
    """The system at a fit, with what the data leave undetermined under its noise held; the fit itself where that is nothing.

    Held kinematic parameters return to their nominal values. Raises as ``determined``.
    """
    layout, found = hold_undetermined(at)
    if not found:
        return at, found
    lineariser, state = at.lineariser.with_layout(layout), at.estimate.state
    nominal = lineariser.obs.cell.robot.chain
    free = layout.blocks[0].free.reshape(nominal.n, -1)
    chain = nominal.with_errors(np.where(free, state.chain.rows - nominal.rows, 0.0))
    return system(lineariser, replace(at.estimate, state=replace(state, chain=chain)), at.noise, at.weights), found


def hold_undetermined(at: Solution) -> tuple[ParameterLayout, list[Undetermined]]:
    """Hold one parameter after another until the reduced information determines the rest; raises as ``determined``."""
    found: list[Undetermined] = []
    layout = at.lineariser.layout
    if at.determined:
        return layout, found
    scale, names = layout.scale, np.array(layout.names)
    arm = np.flatnonzero(~np.isfinite(layout.sigma))
    H = scale[:, None] * at.normal.information * scale
    reference = None
    kept = np.arange(len(names))
    while len(kept):
        value, vector = np.linalg.eigh(H[np.ix_(kept, kept)])
        if value[0] > 1 / UNDETERMINED**2:
            break
        v = np.abs(vector[:, 0]) * np.isin(kept, arm)
        if not v.any():
            break
        worst = int(np.argmax(v))
        if reference is None:
            reference = scale[:, None] * workspace_information(at.lineariser.obs, at.estimate.state, layout) * scale
        full = np.zeros(len(names))
        full[kept] = vector[:, 0]
        effect = float(np.sqrt(max(full @ reference @ full, 0.0)))
        others = [str(names[kept[i]]) for i in np.argsort(-v) if i != worst and v[i] > 0.3 * v[worst]][:3]
        found.append(Undetermined(str(names[kept[worst]]), tuple(others), effect))
        layout = layout.hold(found[-1].name, found[-1].reason)
        kept = np.delete(kept, worst)
    refuse_undetermined(found, at.lineariser.obs, at.lineariser.options)
    return layout, found


def refuse_undetermined(found: Sequence[Undetermined], obs: Observations, options: CalibrationOptions) -> None:
    """Raise CalibrationError if something is undetermined that would matter elsewhere in the workspace."""
    harmful = [u for u in found if not u.harmless]
    if not harmful or not options.refuse:
        return
    names = [u.name for u in harmful]
    named = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    hand_eye = any(name.startswith("hand_eye") for name in names)
    n_stations = len(np.unique(obs.station))
    if hand_eye:
        advice = "add poses that turn the scanner about two different axes by 20° and more"
    elif n_stations == 1 and obs.cell.measurement != TARGET_IN_BASE:
        advice = "all poses are at one station: put the artefact at more places, at different heights and distances"
    else:
        advice = "add stations at other places and poses with a larger range of joint angles"
    raise CalibrationError(f"the poses do not determine {named}; {advice}, or hold what is not needed")


def workspace_information(obs: Observations, state: CellState, layout: ParameterLayout, count: int = PROBES, seed: int = 1) -> np.ndarray:
    """(g, g): mean square displacement in mm of measured points, over postures within the joint limits, per unit of the free parameters;
    what a rigid motion of everything would explain is taken out, since the base is wherever the stations put it."""
    rng, measured = np.random.default_rng(seed), typical_points(obs)
    low, high = state.chain.drawn_between(obs.cell.robot.limits)
    q = rng.uniform(low, high, size=(count, obs.cell.robot.n))
    twists, T = _twists(layout, state, q)
    points = se3.apply(T[:, None], measured[None])  # (P, K, 3)
    # The points of a posture move by D twist, D = [1, -x]; the same columns, of the base, are those of a rigid motion of everything.
    D = np.concatenate([np.broadcast_to(np.eye(3), (*points.shape, 3)), -se3.skew(points)], axis=3).reshape(len(q), -1, 6)
    squares = np.swapaxes(D, 1, 2) @ D
    moved = squares @ twists
    whole, f = np.zeros((layout.size, layout.size)), twists.shape[2]
    unit = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])  # rotations in mrad: of the size of the translations
    rigid = unit[:, None] * moved.sum(axis=0)
    inverse = np.linalg.pinv(unit[:, None] * squares.sum(axis=0) * unit, hermitian=True)
    whole[:f, :f] = twists.reshape(6 * len(q), f).T @ moved.reshape(6 * len(q), f) - rigid.T @ inverse @ rigid
    return whole / (points.shape[0] * points.shape[1])


def typical_points(obs: Observations) -> np.ndarray:
    """(k, 3) points of the scanner frame that span what was measured; those of the target for an external instrument."""
    if obs.cell.measurement == TARGET_IN_BASE:
        return np.vstack([np.zeros(3), 50 * np.eye(3)]) if obs.rotation is not None else obs.cell.ball_centres[np.unique(obs.ball)]
    middle, spread = obs.xyz.mean(axis=0), obs.xyz.std(axis=0)
    return middle + np.vstack([np.zeros(3), np.diag(spread)]) if spread.max() > 1e-9 else middle[None]


def base_columns(layout: ParameterLayout, state: CellState, q: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivative (P K, 3, g) of points in the base by the free parameters, and the points (P K, 3): the K scanner points xyz (K, 3) at each
    of P postures q (P, n), or points of its own for each posture, xyz (P, K, 3)."""
    twists, T = _twists(layout, state, q)
    points = se3.apply(T[:, None], xyz if xyz.ndim == 3 else xyz[None])
    twists = np.swapaxes(twists, 1, 2)
    moved = twists[:, None, :, :3] + se3.cross(twists[:, None, :, 3:], points[:, :, None, :])
    columns = np.zeros((*points.shape[:2], layout.size, 3))
    columns[:, :, : twists.shape[1]] = moved
    return np.swapaxes(columns, 2, 3).reshape(-1, 3, layout.size), points.reshape(-1, 3)


def _twists(layout: ParameterLayout, state: CellState, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twists (P, 6, f) of the free parameters of arm and hand-eye at postures q (P, n), and T_base_scanner (P, 4, 4)."""
    frames = state.chain.frames(q)
    several = state.T_flange_scanner.ndim == 3  # of several tools, the first stands for all
    T = frames[:, -1] @ (state.T_flange_scanner[0] if several else state.T_flange_scanner)
    arm = state.chain.parameter_twists(frames, q).reshape(len(q), -1, 6)[:, layout.blocks[0].free]
    return np.concatenate([np.swapaxes(arm, 1, 2), se3.adjoint(T)[:, :, layout.blocks[1].free[:6]]], axis=2), T


def correlated_pairs(names: Sequence[str], products: np.ndarray, limit: float) -> list[tuple[str, str, float]]:
    """Names of two and their correlation, where it exceeds a limit, the most alike first. products: (k, k) covariances, or inner ones."""
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    correlation = products / np.outer(size, size)
    i, j = np.nonzero(np.triu(np.abs(correlation) > limit, 1))
    order = np.argsort(-np.abs(correlation[i, j]))
    return [(names[int(a)], names[int(b)], float(correlation[a, b])) for a, b in zip(i[order], j[order], strict=True)]
