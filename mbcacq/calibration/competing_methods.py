"""A calibration that loses against a simpler one is not published.

The model of a calibrated arm lacks something if its joints seem to repeat worse than the arm does. The most careful weighing of the rows
may then no longer be the best. Simpler calibrations of the same recording then compete: each is fitted without a block of poses and
predicts it, block after block. One of them is published in its place where it predicts better beyond scatter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.held_out_poses import gross, held_out_masks, predicted, rms
from mbcacq.calibration.published_cell import cell_of, warned, with_nominal_arm
from mbcacq.calibration.recording_faults import NOISE_FACTOR, joint_factor
from mbcacq.calibration.with_discrepancy import with_discrepancy
from mbcacq.errors import CalibrationError
from mbcacq.estimation.adjustment import Adjustment, adjust_recording, thin, with_random_links
from mbcacq.estimation.options import Noise
from mbcacq.estimation.solver import solve
from mbcacq.estimation.variance_components import first_noise
from mbcacq.model.json_text import AsJson, Vector
from mbcacq.model.observations import Observations

WEIGHTED = "the weighted adjustment"  # what is published unless another predicts better
BLOCKS = 5
LEAST_BLOCKS = 3  # fewer say nothing of their scatter
POSES = 250  # that compete of a longer recording: a block of 50 poses tells 10 % of an rms
POSES_OF_A_STATION = 3  # fewer say little more than where the station is
BEYOND = 2.0  # standard errors by which a method must predict better: blocks lie near fitted poses, and favour what fits there


@dataclass(frozen=True)
class HeldOutComparison(AsJson):
    """Predictions of held-out blocks of one recording by its calibrations.

    Attributes
    ----------
    rms_mm
        By name: (B,) rms (mm, 3D) of every centre of each block. Calibrations that the blocks do not determine are left out.
    chosen
        Name of the calibration that is to be published.
    robust_mm
        The same without gross centres, which every calibration misses; the choice is by these. Empty if no centre is gross.
    centres, robust_centres
        Number of all centres, and of those that are not gross.
    """

    chosen: str
    rms_mm: Mapping[str, Vector]
    robust_mm: Mapping[str, Vector] = field(default_factory=dict)
    centres: int = 0
    robust_centres: int = 0

    def pooled(self, name: str, robust: bool = False) -> float:
        """The rms (mm, 3D) of all blocks together."""
        return float(np.sqrt(np.mean((self.robust_mm if robust else self.rms_mm)[name] ** 2)))

    def sentence(self, own: str) -> str:
        """A sentence for a user who gets another calibration than the one asked for, ``own``."""
        judged = self.robust_mm or self.rms_mm
        better = int(np.sum(judged[self.chosen] < judged[own]))
        robust = (
            f", robust {self.pooled(self.chosen, True):.3f} against {self.pooled(own, True):.3f} mm over {self.robust_centres} of "
            f"{self.centres} centres"
            if self.robust_mm
            else ""
        )
        return (
            f"The joints repeat worse than the arm does, so something is not in the model; {self.chosen} predicts held-out poses better "
            f"({self.pooled(self.chosen):.3f} mm rms against {self.pooled(own):.3f} mm by {own}{robust}, better in {better} of "
            f"{len(self.rms_mm[own])} blocks) and is what this result holds"
        )


def best_on_held_out(cell: CalibratedCell) -> CalibratedCell:
    """The calibration, or where its joints' noise is beyond the data sheet the competing one that predicts held-out poses better.

    Parameters
    ----------
    cell : CalibratedCell
        With its adjustment, and with smooth errors of the joints where the evidence asks for them.
    """
    obs, asked = cell.fit.observations, cell.fit.options
    if joint_factor(cell.adjustment.noise, obs.cell) <= NOISE_FACTOR:
        return cell
    lenient = replace(asked, refuse=False)
    shared: dict[int, tuple[Observations, Adjustment]] = {}  # by identity, with what it is of: what is held here keeps its identity

    def linked(some: Observations) -> Adjustment:
        if id(some) not in shared:  # three of the methods begin with it
            shared[id(some)] = some, with_random_links(adjust_recording(some, lenient, links_follow=True))
        return shared[id(some)][1]

    fits: dict[str, Callable[[Observations], CalibratedCell]] = {
        WEIGHTED: lambda some: with_discrepancy(linked(some)) or cell_of(linked(some)),
        "the adjustment without smooth errors": lambda some: cell_of(linked(some)),
        "plain least squares": lambda some: cell_of(plain_least_squares(linked(some))),
        "the nominal arm": lambda some: with_nominal_arm(cell_of(adjust_recording(some, replace(lenient, kinematics=False)))),
    }
    found = compared_on_held_out(obs, WEIGHTED, fits)
    if found is None:
        return cell
    if found.chosen != WEIGHTED:
        cell = fits[found.chosen](obs)
        fit = replace(cell.fit, options=replace(cell.fit.options, refuse=asked.refuse))
        cell = warned(replace(cell, own_fit=fit), found.sentence(WEIGHTED))
    return replace(cell, extra={**cell.extra, "competing_methods": found.to_dict()})


def compared_on_held_out(
    obs: Observations, own: str, fits: Mapping[str, Callable[[Observations], CalibratedCell]]
) -> HeldOutComparison | None:
    """Calibrations compared on blocks of poses that take no part in them.

    Parameters
    ----------
    obs : Observations
        The recording that is calibrated; of a long one, a part.
    own : str
        Name of the calibration that is published unless another predicts better.
    fits : mapping
        Name -> calibration of some poses. A CalibrationError that they raise takes the calibration out of the comparison.

    Returns
    -------
    HeldOutComparison or None
        None if the recording has too few blocks that can be predicted, or where ``own`` cannot be made without one.
    """
    obs = thin(obs, POSES) if obs.n_poses > POSES else obs
    masks, by_station = _blocks(obs)
    if len(masks) < LEAST_BLOCKS:
        return None
    distances: dict[str, list[np.ndarray]] = {name: [] for name in fits}
    parts = [(obs.select(~mask), obs.select(mask)) for mask in masks]
    for rest, held in parts:
        for name in list(distances):
            try:
                distances[name].append(predicted(held, fits[name](rest), by_station)[0])
            except (CalibrationError, np.linalg.LinAlgError):
                if name == own:
                    return None
                del distances[name]
    kept = [~gross(*block) for block in zip(*distances.values(), strict=True)]
    every = {name: np.array([rms(d) for d in of]) for name, of in distances.items()}
    robust = {name: np.array([rms(d[k]) for d, k in zip(of, kept, strict=True)]) for name, of in distances.items()}
    used = np.concatenate(kept)
    return HeldOutComparison(_chosen(robust, own), every, {} if used.all() else robust, len(used), int(used.sum()))


def plain_least_squares(alone: Adjustment) -> Adjustment:
    """The geometry by least squares: every centre counts alike, no noise of the joints, nothing rejected. Sizes of the links stay as they
    are: without them the error away from the measured poses has no bound.

    Parameters
    ----------
    alone : Adjustment
        By maximum likelihood; its layout is kept, and it is where the iteration starts.

    Returns
    -------
    Adjustment
        Its noise of a point is the rms of the residuals times the root of the number of centres at a pose. The lacks of the model are
        common to them, and its uncertainties take this into account. The joints repeat as the data sheet has it, for predictions.
    """
    obs = alone.lineariser.obs
    every = alone.lineariser.everything
    still, sheet = np.full(obs.cell.robot.n, 1e-9), first_noise(obs.cell).joint
    solution, noise = alone.solution, Noise(np.ones(3), still, 1e-3)
    for _ in range(2):
        solution = solve(solution, noise, every)
        square = np.mean(solution.residual**2, axis=0)
        common = np.sqrt(obs.n_centres / obs.n_poses)
        turn = float(np.sqrt(np.mean(square[3:]))) * common if len(square) > 3 else 1e-3
        noise = Noise(np.full(3, float(np.sqrt(np.mean(square[:3]))) * common), still, turn)
    return replace(alone, solution=solve(solution, noise, every), noise=replace(noise, joint=sheet), weights=every)


def _blocks(obs: Observations) -> tuple[list[np.ndarray], bool]:
    """(P,) masks of the poses to leave out, and whether they are whole stations, whose places nothing else tells. Stations come first: a
    calibration is for places where nothing was measured."""
    stations = np.unique(obs.station)
    if len(stations) < BLOCKS or obs.n_poses < POSES_OF_A_STATION * len(stations):
        try:
            return held_out_masks(obs, "block", None, BLOCKS, 0), False
        except CalibrationError:
            return [], False
    return [np.isin(obs.station, group) for group in np.array_split(stations, BLOCKS)], True


def _chosen(errors: Mapping[str, np.ndarray], own: str) -> str:
    """The one that predicts best, if it predicts better than ``own`` by more than the blocks scatter."""
    best, gain = own, 0.0
    for name in errors:
        lead = np.log(errors[own] / errors[name])
        mean, error = float(lead.mean()), float(lead.std(ddof=1)) / np.sqrt(len(lead))
        if mean > max(gain, BEYOND * error) and np.mean(errors[name] ** 2) < np.mean(errors[own] ** 2):
            best, gain = name, mean
    return best
