"""The problem linearised at an estimate: residual and analytic columns of every free parameter, grouped by pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.estimation import forward_model, terms
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.pose_information import PoseColumns
from mbcacq.estimation.whitening import PoseRows
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class Linearization:
    """At one estimate. residual: (M, R). X: (P, B R, g + 7) columns of the g free parameters, of the pose's own station (6), and the
    residual (1); J: (P, B R, n) of the joints; columns: the same without the products made."""

    prediction: forward_model.Prediction
    residual: np.ndarray
    columns: PoseColumns

    @cached_property
    def X(self) -> np.ndarray:
        return self.columns.dense

    @cached_property
    def J(self) -> np.ndarray:
        return self.columns.basis @ self.columns.joints


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
        rows = self.rows
        order = rows.order
        twists = chain.parameter_twists(prediction.frames, self.obs.q)
        joints = twists[:, :, 0] * chain.sign[:, None]
        mount = np.swapaxes(se3.adjoint(prediction.T_base_scanner), 1, 2)
        station = np.swapaxes(-se3.adjoint(prediction.T_base_station), 1, 2)
        chain_free, mount_free = self.layout.blocks[0].free, self.layout.blocks[1].free
        moving = [twists.reshape(len(twists), -1, 6)[:, chain_free], self._of_recordings(mount)[:, mount_free], station]
        moved, jointly = (np.ascontiguousarray(np.swapaxes(t[order], 1, 2)) for t in (np.concatenate(moving, axis=1), joints))
        basis = rows.pad(prediction.gradient)
        if basis.shape[1] < 6:
            # Fewer rows than a twist has components: the rows themselves are the shorter basis.
            moved, jointly, basis = (
                basis @ moved,
                basis @ jointly,
                np.broadcast_to(np.eye(basis.shape[1]), (len(basis), *basis.shape[1:2] * 2)),
            )
        return Linearization(prediction, residual, PoseColumns(basis, moved, jointly, self._own(prediction), rows.pad(residual)))

    def _own(self, prediction: forward_model.Prediction) -> np.ndarray:
        """(P, B R, e) columns of the balls and of the terms."""
        own = [] if self.ball_columns is None else [self.rows.pad(self._balls(prediction, self.ball_columns))]
        own += [self.rows.pad(terms.columns(self.obs, prediction, one)) for one in self.options.terms]
        if len(own) == 1:
            return own[0]
        return np.concatenate(own, axis=2) if own else np.zeros((self.rows.n_poses, self.rows.depth * self.rows.width, 0))

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
