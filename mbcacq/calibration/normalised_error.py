"""Errors of a transferred cell over the uncertainty that it states: whether the statement holds on another recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.cell_estimate import square_root
from mbcacq.calibration.parts_left_out import differing_terms
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation import parameters
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import system
from mbcacq.model.json_text import Number
from mbcacq.model.observations import Observations

MOST_JUDGED = 1500  # centres at which the normalised error is computed: its mean is known to 2 % then


@dataclass(frozen=True)
class NormalisedError:
    """Errors over their stated standard uncertainty (parameters, effects and noise of measuring, per axis).

    Attributes
    ----------
    rms, quantile_95 : float
        The rms and the 95 % quantile of the normalised errors.
    share_below_3 : float
        Share of centres with an error below 3.
    expected_rms : float or None
        The rms if the statement is true: 1, less the part that the fitted places absorb. None in results of older programs.
    degrees_of_freedom : float or None
        Degrees of freedom of the rms. The errors of the learnt cell are common to many centres, so that they are fewer than centres. None
        in results of older programs.
    """

    rms: Number
    quantile_95: Number
    share_below_3: Number
    expected_rms: Number | None = None
    degrees_of_freedom: Number | None = None

    @property
    def usual(self) -> tuple[float, float] | None:
        """Range of the rms in 95 % of recordings if the statement is true (chi square); None if that is not known."""
        if self.expected_rms is None or self.degrees_of_freedom is None:
            return None
        low, high = self.expected_rms * np.sqrt(chdtri(self.degrees_of_freedom, [0.975, 0.025]) / self.degrees_of_freedom)
        return float(low), float(high)

    @property
    def in_words(self) -> str:
        usual = " ({:.2f} to {:.2f} if it is true)".format(*self.usual) if self.usual else ""
        return f"{self.rms:.2f} rms{usual}, {self.quantile_95:.2f} at 95 %, {self.share_below_3:.1%} below 3"


def normalised_error(fitted: CalibratedCell, cell: CalibratedCell, model: EffectModel, used: np.ndarray) -> NormalisedError:
    """The residual of each centre over its stated uncertainty. The uncertainty consists of the covariance of the learnt arm and effects,
    the variance of effects that differ between recordings, and the noise of measuring. The fitted places absorb a part of the first two.
    """
    obs, residual = fitted.fit.observations, fitted.fit.residual
    rng = np.random.default_rng(0)
    poses = np.sort(rng.permutation(obs.n_poses)[:MOST_JUDGED])
    keep = np.zeros(obs.n_poses, bool)
    keep[poses] = True
    rows = keep[obs.pose]
    some = obs.select(keep)
    terms = model.at(some) if model else ()
    # An effect that differs between recordings has another draw in the other one: a random effect, beside the learnt one.
    differing = differing_terms(model, some, cell)
    options = CalibrationOptions(terms=(*terms, *differing), balls=False, phases=all_phases(some))
    layout = parameters.build(some, options)
    for name in cell.layout.names:
        layout = _freed(layout, name)
    lineariser = Lineariser(some, layout, options)
    estimate = Estimate(fitted.state, (*model.coefficients, *(np.zeros(t.size) for t in differing)))
    weights = Weights(fitted.fit.weights.centre[rows], fitted.fit.weights.pose[keep])
    at = system(lineariser, estimate, fitted.noise, weights)  # base and tool were fitted to all rows of a pose under these weights
    columns = at.columns
    names = layout.names
    learnt = {name: j for j, name in enumerate(cell.layout.names)}
    fitted_there = ("ball_",) if obs.cell.robot.of_flange_poses else ("hand_eye.", "ball_")
    shared = [j for j, name in enumerate(names) if name in learnt and not name.startswith(fitted_there)]
    variance = {name: s**2 for t in differing for name, s in zip(t.names, t.sigma, strict=True)}
    drawn = [j for j, name in enumerate(names) if name in variance]
    index = [learnt[names[j]] for j in shared]
    own = [j for j, name in enumerate(names) if name.startswith("hand_eye.") and j not in shared]
    A = lineariser.rows.unpad(at.normal.reduce(columns.of_parameters, columns.of_station)[0])[:, :3]
    absorbed = np.linalg.solve(at.normal.information[np.ix_(own, own)], at.normal.information[np.ix_(own, [*shared, *drawn])])
    A = A[:, :, [*shared, *drawn]] - A[:, :, own] @ absorbed
    C = np.diag([0.0] * len(shared) + [variance[names[j]] for j in drawn])
    C[: len(shared), : len(shared)] = cell.covariance[np.ix_(index, index)]
    kept = used[rows]
    A = A[kept] @ square_root(C)  # of a hand-eye transform alone C is empty
    joint = (lineariser.rows.unpad(columns.of_joints)[:, :3] * cell.noise.joint)[kept]
    covariance = A @ np.swapaxes(A, 1, 2) + joint @ np.swapaxes(joint, 1, 2)
    covariance[:, np.arange(3), np.arange(3)] += cell.noise.point**2
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    error = np.sqrt(np.mean((whiten @ residual[rows, :3][kept][..., None])[..., 0] ** 2, axis=1))
    return NormalisedError(
        rms=float(np.sqrt(np.mean(error**2))),
        quantile_95=float(np.quantile(error, 0.95)),
        share_below_3=float(np.mean(error < 3)),
        expected_rms=float(np.sqrt(max(1 - fitted.fit.rank / (3 * used.sum()), 0.0))),
        degrees_of_freedom=_degrees_of_freedom(whiten @ A, whiten @ joint, whiten * cell.noise.point, some.pose[kept]),
    )


def _degrees_of_freedom(learnt: np.ndarray, joint: np.ndarray, point: np.ndarray, pose: np.ndarray) -> float:
    """Degrees of freedom of a sum of squares of correlated normalised errors (Satterthwaite): tr(S)^2 / tr(S^2) of their covariance S.

    learnt (m, 3, g), joint (m, 3, n), point (m, 3, 3): factors of the three parts of S. All centres share the errors of the learnt cell,
    those of a pose (m,) share joint noise, and none share noise of points.
    """
    of_pose = [np.flatnonzero(pose == p) for p in np.unique(pose)]
    shared = learnt.reshape(3 * len(pose), learnt.shape[2])
    squares = np.sum((shared.T @ shared) ** 2)
    for rows in of_pose:
        B, J = (part[rows].reshape(3 * len(rows), -1) for part in (learnt, joint))
        within = B @ B.T
        whole = within + J @ J.T
        for k, block in enumerate(point[rows] @ np.swapaxes(point[rows], 1, 2)):
            whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += block
        squares += np.sum(whole**2) - np.sum(within**2)
    return float((3 * len(pose)) ** 2 / squares)


def _freed(layout: parameters.ParameterLayout, name: str) -> parameters.ParameterLayout:
    """The layout with a parameter free."""
    blocks = []
    for b in layout.blocks:
        if name in b.names:
            free = b.free.copy()
            free[b.names.index(name)] = True
            b = replace(b, free=free)
        blocks.append(b)
    return parameters.ParameterLayout(tuple(blocks))


def all_phases(obs: Observations) -> tuple[str, ...] | None:
    """Names of all phases that were recorded."""
    return None if obs.phase is None else tuple(sorted(set(obs.phase.tolist())))
