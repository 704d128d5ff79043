"""The problem linearised at an estimate: residual and analytic columns of every free parameter, grouped by pose."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.estimation import forward_model, terms
from mbcacq.estimation.normal_equations import Prior, prior_rows
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.pose_columns import WIDE, OwnColumns, PoseColumns, WideColumns
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.variance_components import NoisePrior, first_noise, noise_prior, stated_weights
from mbcacq.estimation.whitening import PoseRows
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class EvaluatedEstimate:
    """The recording at one estimate. residual: (M, R); rows: (P, B R) the same as the poses have it, with the covariances that measurements
    state taken out; prior: what is known beforehand."""

    lineariser: Lineariser
    estimate: Estimate
    residual: np.ndarray
    rows: np.ndarray
    prior: Prior

    @cached_property
    def prediction(self) -> forward_model.Prediction:
        """Made again where it was forgotten."""
        return self.lineariser.predicted(self.estimate)


class Lineariser:
    """Evaluates residuals and columns of one recording; keeps what does not depend on the estimate.

    rows: its rows, pose by pose. first_noise: as it is stated. everything: weights with which all of it takes part. layout: the
    parameters; asked: as it was at first, before the data left any of them undetermined.
    """

    def __init__(self, obs: Observations, layout: ParameterLayout, options: CalibrationOptions):
        self.obs, self.options = obs, options
        self.rows = PoseRows(obs, obs.width)
        self.first_noise = first_noise(obs.cell)
        self.own_weight = stated_weights(obs, self.first_noise)
        self.everything = Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
        self.asked = layout
        self._set(layout)

    @property
    def random_links(self) -> tuple[str, ...]:
        """Kinds of link errors that may have a size in common; none where the options have the links free."""
        return self.layout.link_kinds if self.options.random_links else ()

    @cached_property
    def noise_prior(self) -> NoisePrior:
        """Prior of the noise, as the options ask for it."""
        return noise_prior(self.obs.cell, self.options.noise)

    def with_layout(self, layout: ParameterLayout) -> Lineariser:
        """The same recording with other parameters free, or other priors of the same."""
        out = copy(self)
        out._set(layout)
        return out

    def _set(self, layout: ParameterLayout) -> None:
        self.layout = layout
        free = layout.blocks[2].free.reshape(-1, 3)
        whole = free.all(axis=1)
        # A ball of which some coordinates are held has no common pattern, nor have the balls of a pose whose measurements state covariances
        # of their own: then all columns are written out.
        alike = self.own_weight is None and np.array_equal(whole, free.any(axis=1))
        self.free_balls = int(whole.sum()) if alike else 0
        number = np.where(whole, np.cumsum(whole) - 1, self.free_balls) if self.free_balls else np.zeros(len(free), int)
        self.ball = self._in_slots(number, self.free_balls)

    def weighted(self, rows: np.ndarray) -> np.ndarray:
        """Rows (M, R) or (M, R, k), whitened by the covariances that measurements state; unchanged without such covariances."""
        if self.own_weight is None:
            return rows
        return np.einsum("mij,mj->mi", self.own_weight, rows) if rows.ndim == 2 else self.own_weight @ rows

    def unweighted(self, rows: np.ndarray) -> np.ndarray:
        """The inverse of ``weighted``, of rows (M, R)."""
        return rows if self.own_weight is None else np.linalg.solve(self.own_weight, rows[..., None])[..., 0]

    def predicted(self, estimate: Estimate) -> forward_model.Prediction:
        """What should have been measured."""
        moved = None
        if self.options.terms or self.options.displaced:
            known = self.options.displaced
            every = (*self.options.terms, *(term for term, _ in known))
            moved = terms.accumulate(self.obs, every, (*estimate.coefficients, *(values for _, values in known)))
        return forward_model.predict(self.obs, estimate.state, moved)

    def evaluate(self, estimate: Estimate) -> EvaluatedEstimate:
        """Prediction and residual at an estimate, and its distance from what is known beforehand."""
        prediction = self.predicted(estimate)
        residual = forward_model.residual(self.obs, prediction)
        prior = prior_rows(self.obs.cell, self.layout, estimate, self.rows.stations)
        there = EvaluatedEstimate(self, estimate, residual, self.rows.pad(self.weighted(residual)), prior)
        vars(there)["prediction"] = prediction
        return there

    def at(self, there: EvaluatedEstimate) -> PoseColumns:
        """The columns there."""
        chain, prediction = there.estimate.state.chain, there.prediction
        rows, f = self.rows, int(self.layout.blocks[0].free.sum() + self.layout.blocks[1].free.sum())
        moved, of_station, jointly = (np.empty((rows.n_poses, 6, k)) for k in (f, 6, chain.n))
        for block in rows.blocks:
            some = self._twists(chain, prediction, rows.order[block.poses])
            for whole, part in zip((moved, of_station, jointly), some, strict=True):
                whole[block.poses] = np.swapaxes(part, 1, 2)
        gradient = prediction.gradient if self.options.terms else prediction.differentiated()
        basis, size = rows.pad(self.weighted(gradient)), rows.depth * rows.width
        by_rows = size <= 6
        if by_rows:
            # No more rows than a twist has components: the rows themselves are the shorter basis, in which effects are twists as well.
            moved, of_station, jointly = basis @ moved, basis @ of_station, basis @ jointly
            basis = np.broadcast_to(np.eye(size), (len(basis), size, size))
        none = np.zeros((rows.n_poses, size, 0))
        as_twists, turn = by_rows and not self.free_balls, self._turn(prediction)
        beside, wide = self._beside(moved if as_twists else none, prediction, turn, as_twists)
        own = OwnColumns(turn, self.ball, self.free_balls, none if as_twists else beside)
        moved = beside if as_twists else moved
        return PoseColumns(basis, moved, of_station, jointly, own, there.rows, by_rows=by_rows, wide=wide)

    def _twists(self, chain: Chain, prediction: forward_model.Prediction, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Twists of some poses by the free parameters of arm and hand-eye (P, f, 6), by the pose's own station (P, 6, 6) and by the
        joints (P, n, 6)."""
        chain_free, mount_free = self.layout.blocks[0].free, self.layout.blocks[1].free
        twists = chain.parameter_twists(prediction.frames[poses], self.obs.q[poses])
        mount = np.swapaxes(se3.adjoint(prediction.T_base_scanner[poses]), 1, 2)
        station = np.swapaxes(-se3.adjoint(prediction.T_base_station[poses]), 1, 2)
        arm = twists.reshape(len(poses), -1, 6)[:, chain_free]
        moving = np.concatenate([arm, self._of_recordings(mount, poses)[:, mount_free]], axis=1)
        return moving, station, chain.of_joints(twists)

    def _beside(
        self, first: np.ndarray, prediction: forward_model.Prediction, turn: np.ndarray, as_twists: bool
    ) -> tuple[np.ndarray, tuple[WideColumns, ...]]:
        """(P, B R, k): columns of the balls where these are written out, and of each effect, after the first columns (P, B R, f); as
        twists, those of the effects that have many functions of one direction. All columns are in memory once only."""
        rows, end = self.rows, first.shape[2]
        wide: tuple[WideColumns, ...] = ()
        balls = 0 if self.free_balls else int(self.layout.blocks[2].free.sum())
        out = np.empty((*first.shape[:2], end + balls + sum(one.size for one in self.options.terms)))
        out[:, :, :end] = first
        if balls:
            out[:, :, end : end + balls] = self._of_balls(prediction, turn)
            end += balls
        for term in self.options.terms:
            place, one = slice(end, end + term.size), term.parts[0]
            columns = terms.columns(self.obs, prediction, term)
            if as_twists and len(term.parts) == 1 and one.place in terms.PER_POSE and term.size >= WIDE:
                unit = terms.unit(self.obs, prediction, one.place, one.index, one.component)
                wide = (WideColumns(place, rows.pad(self.weighted(unit)), one.basis[rows.order]), *wide)
            out[:, :, place] = rows.pad(self.weighted(columns))
            end = place.stop
        return out, wide

    def _of_balls(self, prediction: forward_model.Prediction, turn: np.ndarray) -> np.ndarray:
        """(P, B R, k) columns of the free coordinates of the balls."""
        rows, free = self.rows, self.layout.blocks[2].free
        if self.own_weight is not None:
            return rows.pad(self.weighted(_shifts(self.obs, prediction, rows.width)))[..., free]
        every, none = np.arange(len(free) // 3), np.zeros((rows.n_poses, rows.depth * rows.width, 0))
        return OwnColumns(turn, self._in_slots(every, len(every)), len(every), none).dense[..., free]

    def _turn(self, prediction: forward_model.Prediction) -> np.ndarray:
        """(P, R, 3): derivative of a centre's rows by the shift of its ball; zero where no ball is free."""
        turn = np.zeros((self.rows.n_poses, self.rows.width, 3))
        if self.layout.blocks[2].free.any():
            # A measured orientation does not depend on a reflector's place.
            turn[:, :3] = prediction.ball_rotation[self.rows.order]
        return turn

    def _in_slots(self, number: np.ndarray, none: int) -> np.ndarray:
        """(P, B): number (K,) of the ball of each centre, ``none`` where there is no centre."""
        out = np.full(self.rows.n_poses * self.rows.depth, none)
        out[self.rows.slot] = number[self.obs.ball]
        return out.reshape(self.rows.n_poses, self.rows.depth)

    def _of_recordings(self, mount: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """(P, 6 R, 6) twists of the R tools from those (P, 6, 6) of each pose's own."""
        which, count = self.obs.recording, len(self.layout.blocks[1].free) // 6  # a part of the poses may lack a whole recording
        if which is None or count == 1:
            return mount
        out = np.zeros((len(mount), count, 6, 6))
        out[np.arange(len(mount)), which[poses]] = mount
        return out.reshape(len(mount), 6 * count, 6)


def _shifts(obs: Observations, prediction: forward_model.Prediction, width: int) -> np.ndarray:
    """(M, R, 3 K): derivative of each centre's rows by the shift of each of the K balls."""
    out = np.zeros((obs.n_centres, width, len(obs.cell.ball_ids), 3))
    out[np.arange(obs.n_centres), :3, obs.ball] = prediction.ball_rotation[obs.pose]
    return out.reshape(obs.n_centres, width, -1)
