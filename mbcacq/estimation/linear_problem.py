"""A recording linearised at an adjusted cell: residual, the columns of everything that geometry can absorb, and of any effect.

It is the same linearisation as the adjustment's, laid out centre by centre. What is known beforehand (certificates, given station poses,
the plausible size of an arm's errors) is a sigma of the nuisance parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.estimation import parameters, terms
from mbcacq.estimation.forward_model import CellState, Prediction
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.normal_equations import Normal, PoseSystem, Prior, known_placement
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.pose_columns import PoseColumns
from mbcacq.estimation.pose_information import PoseInformation, WeightedRows, Weights
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import solve
from mbcacq.estimation.terms import PER_POSE, Part, Term
from mbcacq.estimation.whitening import CentreWhitening, PoseRows
from mbcacq.model.computed_once import ComputedOnce
from mbcacq.model.observations import Observations

STATION_SIGMA = np.array([1e4, 1e4, 1e4, 3.0, 3.0, 3.0])  # mm, rad: of a station whose place nobody stated; wider than any cell


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """The recording linearised at a state of the cell.

    keep: (M,) bool of the centres that take part. residual: (M, R), R = 3, or 6 with a measured orientation: of the arm and the
    artefacts as stated, since priors are about these. columns_by_pose: of the g free parameters of ``layout``, of the pose's own station
    and of the joints. given: effects whose coefficients are known beforehand, each with their means (k,) and, as sigma of the term, their
    standard deviations; they are free parameters, the last ones of ``layout``, as deviations from the means. shared: what depends on the
    linearisation alone, computed once for all its restrictions.
    """

    obs: Observations
    state: CellState
    keep: np.ndarray
    layout: ParameterLayout
    rows: PoseRows
    prediction: Prediction
    residual: np.ndarray
    columns_by_pose: PoseColumns
    given: tuple[tuple[Term, np.ndarray], ...] = ()
    computed_once: ComputedOnce = field(default_factory=ComputedOnce, repr=False)

    @classmethod
    def of(
        cls,
        obs: Observations,
        state: CellState,
        keep: np.ndarray | None = None,
        effects: Sequence[Term] = (),
        coefficients: Sequence[np.ndarray] = (),
        layout: ParameterLayout | None = None,
        given: Sequence[tuple[Term, np.ndarray]] = (),
    ) -> LinearProblem:
        """Linearised at the state, displaced by effects with these coefficients; without keep all centres take part.

        layout: which parameters are free (default: all of the arm, the hand-eye and the certified balls, without those that act alike).
        given: further effects, at the means of their coefficients.
        """
        displaced = (*zip(effects, coefficients, strict=True), *given)
        options = CalibrationOptions(terms=tuple(one for one, _ in given), displaced=displaced)
        layout = parameters.build(obs, options) if layout is None else with_terms(layout, options.terms)
        # Residual, effects and geometry are of one scale: covariances that single measurements state count in the adjustment alone.
        lineariser = Lineariser(replace(obs, covariance=None), layout, options)
        there = lineariser.evaluate(Estimate(state, tuple(np.zeros(one.size) for one, _ in given)))
        every, fixed, columns = np.ones(obs.n_centres, bool), (lineariser.rows, there.prediction, there.residual), lineariser.at(there)
        whole = cls(obs, state, every, layout, *fixed, columns_by_pose=columns, given=tuple(given))
        # Priors are about the nominal arm and the certificates, so the linear problem is for the whole deviation from them: what the state
        # holds of it already is added back.
        off = there.prior.offset
        residual = there.residual + whole.rows.unpad(whole.columns_by_pose.change(off, np.zeros((obs.n_poses, 6))))
        for one, values in zip(effects, coefficients, strict=True):
            residual = residual + terms.columns(obs, there.prediction, one) @ values
        for s, offset in zip(whole.rows.stations, there.prior.station_offset, strict=True):
            if s in whole.given_stations:
                here = obs.station[obs.pose] == s
                residual[here] += whole.station[here] @ offset
        return whole.with_residual(residual).restricted(whole.keep if keep is None else keep)

    @property
    def width(self) -> int:
        """Rows R of one centre."""
        return self.residual.shape[1]

    def __reduce__(self) -> tuple:
        fixed = self.obs, self.state, self.keep, self.layout, self.rows, self.prediction
        return LinearProblem, (*fixed, self.residual, self.columns_by_pose, self.given)

    def restricted(self, keep: np.ndarray) -> LinearProblem:
        """The same linearisation with only the centres in keep (M,) bool."""
        return replace(self, keep=keep)

    def with_residual(self, residual: np.ndarray) -> LinearProblem:
        """The same linearisation of another residual (M, R)."""
        return replace(self, residual=residual, columns_by_pose=replace(self.columns_by_pose, residual=self.rows.pad(residual)))

    # Columns ------------------------------------------------------------------------------------------------------

    @property
    def geometry(self) -> np.ndarray:
        """(M, R, g) columns of the free parameters of ``layout``."""
        return self.computed_once("geometry", lambda: self.rows.unpad(self.columns_by_pose.of_parameters))

    @property
    def station(self) -> np.ndarray:
        """(M, R, 6) columns of the pose's own station."""
        return self.computed_once("station", lambda: self.rows.unpad(self.columns_by_pose.of_station))

    @property
    def joint(self) -> np.ndarray:
        """(P, B R, n) columns of the joints, by pose, and of further noise of each pose."""
        return self.columns_by_pose.of_joints

    @property
    def joint_columns(self) -> np.ndarray:
        """(M, R, n): change of the prediction by each joint's angle."""
        return self.computed_once("joints", lambda: self.rows.unpad(self.joint)[..., : self.obs.cell.robot.n])

    def twist(self, location: str, index: int, component: int) -> np.ndarray:
        """(P, 6): spatial twist of the arm, in the base frame, by a unit of one component of a joint, a frame of the arm or a station."""
        key = location, index, component
        return self.computed_once(("twist", *key), lambda: terms.unit_twist(self.obs, self.prediction, *key))

    def unit(self, location: str, index: int, component: int) -> np.ndarray:
        """(M, R): change of the prediction by a unit of one component of one location."""
        key = (location, index, component)
        return self.computed_once(key, lambda: terms.unit(self.obs, self.prediction, *key))

    def columns(self, parts: Sequence[Part], rows: slice = slice(None)) -> np.ndarray:
        """(M, R, k): columns of an effect; of these of the R rows of each centre."""
        total = np.zeros(())
        for part in parts:
            unit = self.unit(part.place, part.index, part.component)[:, rows, None]
            total = total + unit * self.by_centre(part, part.basis)[:, None, :]
        return total

    def twists_of(self, parts: Sequence[Part]) -> np.ndarray:
        """(P, u, k): an effect whose parts move poses as a whole, by the twists of ``columns_by_pose`` and in the order of its poses."""
        total = np.zeros(())
        for part in parts:
            key = part.place, part.index, part.component
            moved = self.rows.pad(self.unit(*key)) if self.columns_by_pose.by_rows else self.twist(*key)[self.rows.order]
            total = total + moved[:, :, None] * part.basis[self.rows.order][:, None, :]
        return total

    def displacement(self, parts: Sequence[Part], coefficients: np.ndarray) -> np.ndarray:
        """(M, R): the columns of an effect times its coefficients (k,); no column is written out."""
        amounts = (self.by_centre(part, part.basis @ coefficients) for part in parts)
        moved = (self.unit(p.place, p.index, p.component) * a[:, None] for p, a in zip(parts, amounts, strict=True))
        return sum(moved, np.zeros_like(self.residual))

    def products(self, parts: Sequence[Part], rows: np.ndarray) -> np.ndarray:
        """(k,): the columns of an effect times rows (M, R); no column is written out."""
        total = np.zeros(parts[0].basis.shape[1])
        for part in parts:
            each = np.einsum("mr,mr->m", self.unit(part.place, part.index, part.component), rows)
            total += part.basis.T @ (np.bincount(self.obs.pose, each, self.obs.n_poses) if part.place in PER_POSE else each)
        return total

    def by_centre(self, part: Part, values: np.ndarray) -> np.ndarray:
        """(M, ...): values for each row of a part's basis, centre by centre."""
        return values[self.obs.pose] if part.place in PER_POSE else values

    # What geometry absorbs ----------------------------------------------------------------------------------------

    @property
    def sigma(self) -> np.ndarray:
        """(g,) prior sigma of the free parameters: of a certificate, else the size that such an error may plausibly have."""
        sigma, scale = self.layout.sigma, self.layout.scale
        return np.where(np.isfinite(sigma), sigma, scale)

    @property
    def given_stations(self) -> list[int]:
        """Stations in use whose place in the base was given."""
        return [int(s) for s in self.rows.stations if self.obs.cell.stations[s].T_base_station is not None]

    @property
    def own_station(self) -> np.ndarray:
        """(M, R, 6) columns of the pose's own station, in units of the prior sigma of its pose."""
        return self.computed_once("own station", self._own_station)

    def _own_station(self) -> np.ndarray:
        out, flat = self.station * STATION_SIGMA, self.station.reshape(-1, 6)
        for s, rows in zip(self.rows.stations, self.rows_of_stations, strict=True):
            if s in self.given_stations:
                root = np.linalg.cholesky(_given(self.obs, self.state, int(s)))
                out.reshape(-1, 6)[rows] = flat[rows] @ np.linalg.inv(root).T
        return out

    @property
    def rows_of_stations(self) -> list[slice | np.ndarray]:
        """The rows, of M R, of each station in use; slices where they follow each other."""
        return self.computed_once("rows of stations", self._rows_of_stations)

    def _rows_of_stations(self) -> list[slice | np.ndarray]:
        station = np.repeat(self.obs.station[self.obs.pose], self.width)
        return [as_slice(np.flatnonzero(station == s)) for s in self.rows.stations]

    def station_columns(self, stations: Sequence[int] | np.ndarray) -> np.ndarray:
        """(M, R, 6 S') columns of the poses of some stations, in units of their prior sigma."""
        station = self.obs.station[self.obs.pose]
        return np.concatenate([np.where((station == s)[:, None, None], self.own_station, 0.0) for s in stations], axis=2)

    def nuisance(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns (M, R, z) of the stations in use, six each, and of the free geometry, and their prior sigma (z,)."""
        stations = self.station_columns(self.rows.stations)
        return np.concatenate([stations, self.geometry], axis=2), np.concatenate([np.ones(stations.shape[2]), self.sigma])

    def whitener(self, noise: Noise) -> CentreWhitening:
        return CentreWhitening(self.rows, self.joint, noise, self.keep)

    def extended(self, columns: np.ndarray, sigma: np.ndarray) -> ExtendedProblem:
        """Geometry together with columns (M, R, k) of prior sigma (k,)."""
        return self._extended(self.columns_by_pose.with_parameters(self.rows.pad(columns)), np.concatenate([self.sigma, sigma]))

    def extended_by_twists(self, twists: np.ndarray, sigma: np.ndarray) -> ExtendedProblem:
        """Geometry together with parameters of prior sigma (k,), each of which moves every pose by a twist, ``twists_of``; they come after
        those of arm and hand-eye.
        """
        first = self.columns_by_pose.twists.shape[2]
        return self._extended(self.columns_by_pose.with_twists(twists), np.insert(self.sigma, first, sigma))

    def _extended(self, every: PoseColumns, widths: np.ndarray) -> ExtendedProblem:
        information = np.zeros((len(self.rows.stations), 6, 6))
        for j, s in enumerate(self.rows.stations):
            if s in self.given_stations:
                information[j] = _given(self.obs, self.state, int(s))
        prior = Prior(widths, np.zeros(len(widths)), information, np.zeros((len(information), 6)))
        weighted = WeightedRows(self.rows, every, self.keep.astype(float), np.ones(self.rows.n_poses))
        return ExtendedProblem(every, weighted, prior)

    # Adjustment with effects --------------------------------------------------------------------------------------

    def adjusted(self, effects: Sequence[Term], noise: Noise) -> LinearProblem:
        """The cell adjusted anew with effects in place (the engine's own damped solution), and linearised there."""
        every = (*(one for one, _ in self.given), *effects)
        options = CalibrationOptions(terms=every, displaced=self.given)
        weights = Weights(self.keep.astype(float), np.ones(self.obs.n_poses))
        start = Estimate(self.state, tuple(np.zeros(e.size) for e in every))
        lineariser = Lineariser(self.obs, self._with_priors(every), options)
        found = solve(system(lineariser, start, noise, weights), tolerance=0.1, limit=10, within_linear=True).estimate
        of_effects = found.coefficients[len(self.given) :]
        return LinearProblem.of(self.obs, found.state, self.keep, effects, of_effects, self.layout, self.given)

    def _with_priors(self, effects: Sequence[Term]) -> ParameterLayout:
        blocks = tuple(replace(b, sigma=np.where(np.isfinite(b.sigma), b.sigma, b.scale)) for b in self.layout.blocks[:3])
        return with_terms(ParameterLayout(blocks), effects)


@dataclass(frozen=True)
class ExtendedProblem:
    """Geometry and further columns of a recording, before any noise. prior: of the parameters and of the stations with a given place."""

    columns: PoseColumns
    weighted: WeightedRows
    prior: Prior

    def at(self, noise: Noise) -> PoseSystem:
        """The whitened normal equations under a noise, stations eliminated."""
        poses = PoseInformation(self.weighted, self.columns, noise)
        return PoseSystem(poses, Normal(self.weighted.rows, poses.products(), poses.right_hand_side(), self.prior))


def with_terms(layout: ParameterLayout, effects: Sequence[Term]) -> ParameterLayout:
    """The parameters of arm, hand-eye and balls of a layout, and the coefficients of these effects."""
    return ParameterLayout((*layout.blocks[:3], *(parameters.term_block(e) for e in effects)))


def _given(obs: Observations, state: CellState, s: int) -> np.ndarray:
    """Information (6, 6) of a station whose place was given."""
    given = obs.cell.stations[s].T_base_station
    assert given is not None, "asked of stations with a given place only"
    information, _ = known_placement(obs.cell, s, given, state.T_base_station[s])
    return information + np.diag(STATION_SIGMA**-2)  # one or two balls leave a direction of the place open


def as_slice(index: np.ndarray) -> slice | np.ndarray:
    """Indices that follow each other as a slice, others as they are."""
    return slice(index[0], index[-1] + 1) if index[-1] - index[0] == len(index) - 1 else index
