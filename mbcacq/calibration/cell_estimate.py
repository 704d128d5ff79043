"""The estimated model of a cell: where it puts points, how uncertain they are, and the derivatives and the noise that make them so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation import identifiability
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.estimation.terms import Term
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations


@dataclass(frozen=True, repr=False, kw_only=True)
class CellEstimate:
    """Arm, hand-eye, stations, balls and effects with their covariance. Lengths mm, angles rad.

    Attributes
    ----------
    state : CellState
        The arm with its errors, T_flange_scanner (4, 4), T_base_station (S, 4, 4), balls (K, 3) mm.
    layout : ParameterLayout
        Names and freedom of the parameters.
    covariance : ndarray
        (g, g) of the free parameters in the order of ``names``; those of the hand-eye are a local twist (scanner frame).
    noise : Noise
        Noise of a centre and of the joints.
    effects : EffectModel or None
        What the arm does beyond its geometry.
    """

    state: CellState
    layout: ParameterLayout
    covariance: np.ndarray
    noise: Noise
    effects: EffectModel | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of the covariance."""
        return self.layout.names

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Frames of the arm, with its effects, in the base frame.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles as the controller reports them, rad.

        Returns
        -------
        (P, n+1, 4, 4) ndarray
            Lengths in mm.
        """
        return self.effects.frames(self.state.chain, q) if self.effects else self.state.chain.frames(q)

    def placed(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Points that move with the flange, in the base frame.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the frame of what is on the flange, mm: of the scanner, or of a target.

        Returns
        -------
        (P, 3) ndarray
            Points in the base frame, mm.
        """
        return se3.apply(self.frames(q)[:, -1] @ self.state.T_flange_scanner, self.corrected_points(q, xyz))

    def corrected_points(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Scanner points without the bias that effects of the scanner add to them.

        The bias is taken at the measured point: over a distance of its own size it changes by a millionth of itself.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the scanner frame, mm.

        Returns
        -------
        (P, 3) ndarray
            Points in the scanner frame, mm.
        """
        moved = self.effects.displacements(single_points(self.effects, q, xyz)) if self.effects else None
        return xyz if moved is None or moved.point is None else xyz - moved.point

    def point_columns(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Derivatives of base positions by the free parameters, effects included.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the scanner frame, mm.

        Returns
        -------
        (P, 3, g) ndarray
            In mm over the unit of each of the g parameters.
        """
        A = identifiability.base_columns(self.layout, self.state, q, xyz[:, None])[0]
        position = {name: j for j, name in enumerate(self.names)}
        terms = self.effects.at(single_points(self.effects, q, xyz)) if self.effects else ()
        free = [t for t in terms if t.names[0] in position]  # the others are held
        for t, columns in zip(free, term_columns(self.state, free, q, xyz), strict=True):
            A[:, :, [position[name] for name in t.names]] = columns
        return A

    def point_errors(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Errors of base positions by independent causes: the calibrated parameters, and what effects may be beyond where they were learnt.

        All uncertainties of predictions are made of it. The covariance of two points is the product of their errors.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the scanner frame, mm.

        Returns
        -------
        (P, 3, r) ndarray
            In mm, for each of r causes of unit variance.
        """
        known = self.point_columns(q, xyz) @ square_root(self.covariance)
        beyond = self.effects.beyond(single_points(self.effects, q, xyz)) if self.effects else ()
        open_ = [columns * t.sigma for t, columns in zip(beyond, term_columns(self.state, beyond, q, xyz), strict=True)]
        return np.concatenate([known, *open_], axis=2)

    def point_covariance(self, q: np.ndarray, xyz: np.ndarray, *, measuring: bool = False) -> np.ndarray:
        """Covariance of base positions by their ``point_errors``. The base is where the held parameters (theta_1, d_1) put it.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the scanner frame, mm.
        measuring
            Add the scanner's noise and the joints' repeatability of one measurement.

        Returns
        -------
        (P, 3, 3) ndarray
            In mm^2, base frame.
        """
        A = self.point_errors(q, xyz)
        covariance = A @ np.swapaxes(A, 1, 2)
        return covariance + self.measuring_covariance(q, xyz) if measuring else covariance

    def measuring_covariance(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Covariance of one measurement by scanner noise and joint repeatability.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the scanner frame, mm.

        Returns
        -------
        (P, 3, 3) ndarray
            In mm^2, base frame.
        """
        seen, moved = measuring_terms(self.state, self.noise, q, xyz)
        return seen + moved

    def distance_errors(self, qa: np.ndarray, a: np.ndarray, qb: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions from points a to points b, and errors of their distances by independent causes, as of ``point_errors``.

        Parameters
        ----------
        qa : (P, n) ndarray
            Joint angles at which points a were seen, rad.
        a : (P, 3) ndarray
            Points in the scanner frame, mm.
        qb, b : (P, n) and (P, 3) ndarray
            The same of points b.

        Returns
        -------
        tuple of ndarray
            Unit vectors (P, 3) in the base frame; errors (P, r) in mm, for each of r causes of unit variance.
        """
        pa, pb = self.placed(qa, a), self.placed(qb, b)
        u = (pb - pa) / np.linalg.norm(pb - pa, axis=1, keepdims=True)
        return u, np.einsum("pi,pig->pg", u, self.point_errors(qb, b) - self.point_errors(qa, a))

    def distance_uncertainty(self, qa: np.ndarray, a: np.ndarray, qb: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Standard uncertainty of distances by their ``distance_errors``; the noise of measuring the ends is not included.

        Parameters
        ----------
        qa : (P, n) ndarray
            Joint angles at which points a were seen, rad.
        a : (P, 3) ndarray
            Points in the scanner frame, mm.
        qb, b : (P, n) and (P, 3) ndarray
            The same of points b.

        Returns
        -------
        (P,) ndarray
            In mm, k = 1.
        """
        return np.linalg.norm(self.distance_errors(qa, a, qb, b)[1], axis=1)


def single_points(effects: EffectModel, q: np.ndarray, xyz: np.ndarray) -> Observations:
    """Scanner points xyz (P, 3) mm, one seen from each posture q (P, n) rad, as observations at which effects can be evaluated."""
    index = np.arange(len(q))
    return replace(effects.poses(q), pose=index, ball=np.zeros(len(q), dtype=int), xyz=np.asarray(xyz, dtype=float))


def term_columns(state: CellState, terms: Sequence[Term], q: np.ndarray, xyz: np.ndarray) -> list[np.ndarray]:
    """Derivatives (P, 3, k) of the base position of xyz (P, 3) mm, seen from q (P, n) rad, by the coefficients of each term."""
    F = state.chain.frames(q)
    T = F[:, -1] @ state.T_flange_scanner
    point = se3.apply(T, xyz)
    joints = state.chain.joint_twists(F)
    found = []
    for one in terms:
        columns = np.zeros((len(q), 3, one.size))
        for part in one.parts:
            if part.place in ("joint", "frame"):
                twist = joints[:, part.index] if part.place == "joint" else se3.adjoint(F[:, part.index])[:, :, part.component]
                moved = twist[:, :3] + np.cross(twist[:, 3:], point)
                columns += moved[:, :, None] * part.basis[:, None, :]
            elif part.place == "point":
                columns -= T[:, :3, part.component, None] * part.basis[:, None, :]
        found.append(columns)
    return found


def square_root(C: np.ndarray) -> np.ndarray:
    """A square root of a covariance (g, g) of any rank: C = root root'. Units differ, so that it is taken of correlations."""
    deviation = np.sqrt(np.diag(C))
    scale = np.where(deviation > 0, deviation, 1.0)
    size, directions = np.linalg.eigh(C / np.outer(scale, scale))
    return deviation[:, None] * directions * np.sqrt(np.maximum(size, 0.0))


def measuring_terms(state: CellState, noise: Noise, q: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scanner noise, and joint repeatability, of one measurement: (P, 3, 3) mm^2 each, in the base."""
    frames = state.chain.frames(q)
    T = frames[:, -1] @ state.T_flange_scanner
    point = se3.apply(T, xyz)
    twists = state.chain.joint_twists(frames)
    joint = (twists[..., :3] + np.cross(twists[..., 3:], point[:, None])) * noise.joint[:, None]
    turned = T[:, :3, :3] * noise.point
    return turned @ np.swapaxes(turned, 1, 2), np.swapaxes(joint, 1, 2) @ joint
