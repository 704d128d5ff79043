"""The problem linearised at an estimate: residual and analytic columns of every free parameter, grouped by pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.estimation import forward_model, terms
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.whitening import PoseRows
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class Linearization:
    """At one estimate. residual: (M, R). X: (P, B R, g + 7) columns of the g free parameters, of the pose's own station (6), and the
    residual (1); J: (P, B R, n) of the joints."""

    prediction: forward_model.Prediction
    residual: np.ndarray
    X: np.ndarray
    J: np.ndarray


class Lineariser:
    """Evaluates residuals and columns of one recording; keeps what does not depend on the estimate."""

    def __init__(self, observations: Observations, layout: ParameterLayout, options: CalibrationOptions):
        self.obs, self.layout, self.options = observations, layout, options
        width = 3 if observations.rotation is None else 6
        self.rows = PoseRows(observations, width)
        self.ball_columns = self._ball_columns()

    def residual(self, estimate: Estimate) -> tuple[forward_model.Prediction, np.ndarray]:
        """Prediction and residual (M, R) at an estimate."""
        moved = None
        if self.options.terms or self.options.displaced:
            known = self.options.displaced
            every = (*self.options.terms, *(term for term, _ in known))
            moved = terms.accumulate(self.obs, every, (*estimate.coefficients, *(values for _, values in known)))
        prediction = forward_model.predict(self.obs, estimate.state, moved)
        return prediction, forward_model.residual(self.obs, prediction)

    def __call__(self, estimate: Estimate) -> Linearization:
        prediction, residual = self.residual(estimate)
        return self.at(estimate.state.chain, prediction, residual)

    def at(self, chain: Chain, prediction: forward_model.Prediction, residual: np.ndarray) -> Linearization:
        """The columns at a prediction by an arm ``chain``, next to any residual (M, R)."""
        obs, rows = self.obs, self.rows
        order = rows.order
        G = rows.pad(prediction.gradient)
        twists = chain.parameter_twists(prediction.frames, obs.q).reshape(obs.n_poses, -1, 6)
        mount = np.swapaxes(se3.adjoint(prediction.T_base_scanner), 1, 2)
        joints = chain.joint_twists(prediction.frames)
        station = np.swapaxes(-se3.adjoint(prediction.T_base_station), 1, 2)
        chain_free, mount_free = self.layout.blocks[0].free, self.layout.blocks[1].free
        # One product for everything that moves the arm or the artefact as a whole.
        arm = np.concatenate([twists[:, chain_free], self._of_recordings(mount)[:, mount_free], station, joints], axis=1)[order]
        columns = G @ np.swapaxes(arm, 1, 2)
        n, g, free = joints.shape[1], self.layout.size, int(chain_free.sum() + mount_free.sum())
        X = np.empty((*columns.shape[:2], g + 7))
        X[..., :free] = columns[..., :free]
        X[..., g : g + 6] = columns[..., free : free + 6]
        X[..., g + 6] = rows.pad(residual)
        if self.ball_columns is not None:
            count = int(self.layout.blocks[2].free.sum())
            X[..., free : free + count] = rows.pad(self._balls(prediction, self.ball_columns))
            free += count
        for one in self.options.terms:
            X[..., free : free + one.size] = rows.pad(terms.columns(obs, prediction, one))
            free += one.size
        return Linearization(prediction, residual, X, columns[..., -n:])

    def _of_recordings(self, mount: np.ndarray) -> np.ndarray:
        """(P, 6 R, 6) twists of the R tools from those (P, 6, 6) of the pose's own."""
        which, count = self.obs.recording, self.obs.n_recordings
        if which is None or count == 1:
            return mount
        out = np.zeros((len(mount), count, 6, 6))
        out[np.arange(len(mount)), which] = mount
        return out.reshape(len(mount), 6 * count, 6)

    def _ball_columns(self) -> np.ndarray | None:
        """(M, 3) column of each centre's ball coordinates among the free ball parameters (-1 where held), or None if all are held."""
        free = self.layout.blocks[2].free
        if not free.any():
            return None
        position = np.where(free, np.cumsum(free) - 1, -1).reshape(-1, 3)
        return position[self.obs.ball]

    def _balls(self, prediction: forward_model.Prediction, ball_columns: np.ndarray) -> np.ndarray:
        count = int(self.layout.blocks[2].free.sum())
        jacobian = forward_model.ball_jacobian(self.obs, prediction)
        width = prediction.gradient.shape[1]  # a measured orientation does not depend on a reflector's place
        out = np.zeros((self.obs.n_centres, width, count + 1))  # the last column takes what belongs to held balls
        centre = np.arange(self.obs.n_centres)[:, None, None]
        out[centre, np.arange(3)[None, :, None], ball_columns[:, None, :]] = jacobian
        return out[..., :count]
