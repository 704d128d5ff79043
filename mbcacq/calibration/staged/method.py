"""The stages in their order, on a recording: angle adjustment, virtual point, hand-eye rotation and translation, distance constraint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.calibration.observation_fit import ObservationFit
from mbcacq.calibration.staged import distance_constraint
from mbcacq.calibration.staged.pair_distances import Measured, PairDistances, one_pair, scanner_noise, several_balls
from mbcacq.calibration.staged.stages import adjust_angles, preliminary
from mbcacq.calibration.sufficiency import refuse_one_station
from mbcacq.errors import CalibrationError
from mbcacq.estimation import identifiability, parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.initial_guess import with_all_stations
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.estimation.parameters import Estimate, ParameterBlock, ParameterLayout
from mbcacq.estimation.solution import system
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations


def calibrate_paper(observations: Observations, options: CalibrationOptions) -> CalibratedCell:
    """The published method on a recording. Raises CalibrationError if its stages lack what they need."""
    whole = select_phases(observations, options)
    if whole.cell.measurement == TARGET_IN_BASE or not np.any(np.abs(whole.xyz) > 1e-9):
        raise CalibrationError(
            "the paper's method needs a scanner on the flange that sees several balls at a pose; use --method ml for this recording"
        )
    obs = several_balls(whole, options.pairs)
    adjusted, stages, smoother = adjust_angles(obs)
    X, more = preliminary(adjusted)
    nowhere = np.tile(np.eye(4), (len(obs.cell.stations), 1, 1))
    first = with_all_stations(adjusted, CellState(obs.cell.robot.chain, X, nowhere, obs.cell.ball_centres))
    position = np.zeros(obs.n_poses, bool) if obs.phase is None else obs.phase == "position"
    position = position if position.any() else ~position
    where = adjusted.select(position)
    measured = Measured(scanner_noise(obs), tuple(smoother[p] for p in np.flatnonzero(position)))
    layout = published_layout(obs, options)
    at = constraint(where, options.pairs)
    found = identify(where, first, at, layout, options, measured)
    figures = {"pairs_of_balls": options.pairs, "distances": len(at.a), "iterations": found.iterations}
    figures |= {"rms_distance_before_mm": found.rms_before, "rms_distance_after_mm": found.rms_after}
    stages = [*stages, *more, {"stage": "distance constraint (Eq. 13-24)", **figures}]
    state = with_all_stations(obs, replace(first, chain=found.chain, T_flange_scanner=found.T_flange_scanner))
    return _as_cell(obs, options, layout, state, first, found, stages)


def constraint(obs: Observations, how: str) -> PairDistances:
    """The distances of the recording that count: between the balls of one pair of each artefact (how = 'one'), or between all of them."""
    at = distance_constraint.pairs(obs.pose, obs.station[obs.pose], obs.ball, obs.cell.ball_centres)
    if how != "one":
        return at
    keep = one_pair(obs)
    keep = keep[obs.ball[at.a]] & keep[obs.ball[at.b]]
    return PairDistances(at.a[keep], at.b[keep], at.certified[keep])


def identify(
    obs: Observations, first: CellState, at: PairDistances, layout: ParameterLayout, options: CalibrationOptions, measured: Measured
) -> distance_constraint.Identified:
    """The last stage. Raises CalibrationError if the distances leave a direction undetermined that matters in the workspace."""
    free = np.concatenate([b.free for b in layout.blocks[:2]])
    if len(at.a) < free.sum():
        raise CalibrationError(
            f"{len(at.a)} pairs of balls were seen from different poses of one station, the distance constraint has "
            f"{free.sum()} unknowns; take several orientations at each position of the artefact"
        )
    if options.refuse and options.kinematics:
        refuse_one_station(obs)
    found = distance_constraint.identify(first.chain, first.T_flange_scanner, obs, at, free, measured)
    if found.unobservable.shape[1] and options.refuse:
        scale = layout.scale
        basis = np.linalg.qr(found.unobservable / scale[:, None])[0]
        reference = scale[:, None] * identifiability.workspace_information(obs, first, layout) * scale
        effect, vector = np.linalg.eigh(basis.T @ reference @ basis)
        if effect[-1] > identifiability.VISIBLE_MM**2:
            size = np.abs(basis @ vector[:, -1])
            named = ", ".join(layout.names[i] for i in np.argsort(-size)[:4] if size[i] > 0.1 * size.max())
            raise CalibrationError(
                f"the distances between the balls of different poses do not determine {named}; "
                "add positions of the artefact, and orientations about two axes at each"
            )
    return found


def published_layout(obs: Observations, options: CalibrationOptions) -> ParameterLayout:
    """Free as in the paper's Table 1: everything but d before a parallel axis, and beta only there. Without kinematics the links are
    held, and the distances identify the hand-eye transform alone."""
    if not options.kinematics:
        return parameters.build(obs, replace(options, balls=False, terms=(), discrepancy=False))
    layout = parameters.build(obs, replace(options, balls=False, terms=()))
    parallel = obs.cell.robot.chain.parallel_next()
    free = np.ones((obs.cell.robot.n, 5), bool)
    free[parallel, 1] = False
    free[~parallel, 4] = False
    block = layout.blocks[0]
    kept = {name: why for name, why in block.why.items() if not free.reshape(-1)[block.names.index(name)]}
    kept |= {name: "not in the paper's model" for name, f in zip(block.names, free.reshape(-1), strict=True) if not f and name not in kept}
    return ParameterLayout(
        (ParameterBlock(block.name, block.names, block.units, free.reshape(-1), block.sigma, block.scale, kept), *layout.blocks[1:])
    )


def _as_cell(obs, options, layout, state, first, found, stages) -> CalibratedCell:
    lineariser = Lineariser(obs, layout, replace(options, terms=()))
    weights = lineariser.everything
    at = system(lineariser, Estimate(state), found.noise, weights)
    rank = int(found.free.sum()) - found.unobservable.shape[1] + 6 * len(lineariser.rows.stations)
    whitened = at.whitened_residual
    fit = ObservationFit(
        observations=obs,
        options=options,
        coefficients=(),
        station_covariance=np.zeros((len(obs.cell.stations), 6, 6)),
        weights=weights,
        residual=at.residual,
        whitened=whitened,
        chi2=float(np.sum(whitened**2)),
        dof=whitened.size - rank,
        rank=rank,
        iterations=found.iterations,
    )
    estimate = CellEstimate(state=state, layout=layout, covariance=found.covariance, noise=found.noise)
    return CalibratedCell.fitted(fit, estimate, first, {"stages": stages})
