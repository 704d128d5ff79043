"""The estimated model of a cell: where it puts points, how uncertain they are, and the derivatives and the noise that make them so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation import identifiability
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import ParameterLayout
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

    def to_base(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Scanner points in the base frame.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the scanner frame, mm.

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
        if self.effects:
            fill_effect_columns(A, self.names, self.state, self.effects, q, xyz)
        return A

    def point_covariance(self, q: np.ndarray, xyz: np.ndarray, *, measuring: bool = False) -> np.ndarray:
        """Covariance of base positions by the calibrated parameters. The base is where the held parameters (theta_1, d_1) put it.

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
        A = self.point_columns(q, xyz)
        covariance = A @ self.covariance @ np.swapaxes(A, 1, 2)
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

    def distance_columns(self, qa: np.ndarray, a: np.ndarray, qb: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions from points a to points b, and derivatives of their distances by the free parameters.

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
            Unit vectors (P, 3) in the base frame; derivatives (P, g) in mm over the unit of each parameter.
        """
        pa, pb = self.to_base(qa, a), self.to_base(qb, b)
        u = (pb - pa) / np.linalg.norm(pb - pa, axis=1, keepdims=True)
        return u, np.einsum("pi,pig->pg", u, self.point_columns(qb, b) - self.point_columns(qa, a))

    def distance_uncertainty(self, qa: np.ndarray, a: np.ndarray, qb: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Standard uncertainty of distances by the calibrated parameters; the noise of measuring the ends is not included.

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
        row = self.distance_columns(qa, a, qb, b)[1]
        return np.sqrt(np.sum(row @ self.covariance * row, axis=1))


def single_points(effects: EffectModel, q: np.ndarray, xyz: np.ndarray) -> Observations:
    """Scanner points xyz (P, 3) mm, one seen from each posture q (P, n) rad, as observations at which effects can be evaluated."""
    index = np.arange(len(q))
    return replace(effects.poses(q), pose=index, ball=np.zeros(len(q), dtype=int), xyz=np.asarray(xyz, dtype=float))


def fill_effect_columns(
    A: np.ndarray, names: Sequence[str], state: CellState, effects: EffectModel, q: np.ndarray, xyz: np.ndarray
) -> None:
    """Write the derivatives of the base position of xyz (P, 3) mm, seen from q (P, n) rad, by the coefficients of effects into A.

    Parameters
    ----------
    A : ndarray
        (P, 3, g), changed in place.
    names : sequence of str
        Names of its g columns; effects that are not among them are held.
    """
    position = {name: j for j, name in enumerate(names)}
    here = Covariates(single_points(effects, q, xyz))
    F = state.chain.frames(q)
    T = F[:, -1] @ state.T_flange_scanner
    point = se3.apply(T, xyz)
    joints = state.chain.joint_twists(F)
    for one in effects.terms:
        if one.names[0] not in position:
            continue  # held
        columns = np.zeros((len(q), 3, one.k))
        for part in one.parts_at(here, effects.learnt):
            if part.place in ("joint", "frame"):
                twist = joints[:, part.index] if part.place == "joint" else se3.adjoint(F[:, part.index])[:, :, part.component]
                moved = twist[:, :3] + np.cross(twist[:, 3:], point)
                columns += moved[:, :, None] * part.basis[:, None, :]
            elif part.place == "point":
                columns -= T[:, :3, part.component, None] * part.basis[:, None, :]
        A[:, :, [position[name] for name in one.names]] = columns


def measuring_terms(state: CellState, noise: Noise, q: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scanner noise, and joint repeatability, of one measurement: (P, 3, 3) mm^2 each, in the base."""
    frames = state.chain.frames(q)
    T = frames[:, -1] @ state.T_flange_scanner
    point = se3.apply(T, xyz)
    twists = state.chain.joint_twists(frames)
    joint = (twists[..., :3] + np.cross(twists[..., 3:], point[:, None])) * noise.joint[:, None]
    turned = T[:, :3, :3] * noise.point
    return turned @ np.swapaxes(turned, 1, 2), np.swapaxes(joint, 1, 2) @ joint
