"""Whether a recording contradicts its description: noise and link errors as they would have to be, against what they may be.

A calibration estimates the noise, and an estimate adapts: after the fit everything looks as it should. So the judgement is made with the
sizes that statement and data sheet give. Each kind of error then has a ratio, the square root of its required over its allowed variance.
The ratio is about 1, within a factor, for any cell that is as described, and grows in proportion to a fault.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.description import misdescribed
from mbcacq.calibration.description_hypotheses import exchanged_balls
from mbcacq.calibration.published_cell import warned
from mbcacq.calibration.recording_faults import beyond_noise, fault_of
from mbcacq.calibration.target_size import wrong_length
from mbcacq.errors import CalibrationError
from mbcacq.estimation import parameters
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.parameters import ORDINARY_LINKS, ParameterLayout
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import Solution, system
from mbcacq.estimation.solver import solve
from mbcacq.estimation.variance_components import first_noise, reml_score_and_information
from mbcacq.model.cell import Cell
from mbcacq.model.json_text import AsJson

# By which factor what is allowed must be exceeded: three times and more what 120 simulated recordings of ordinary arms show at most
# (scanner 1.10, joints 0.86, links 1.5 with errors of 0.15 mm and 0.03 deg).
MOST_SCANNER = 2.0
MOST_JOINT = 2.5
MOST_LINK = 6.0  # an arm three times as far off as ordinary ones reaches 4.5
UNSTATED = 3.0  # further factor where no figure of the instrument or of the arm is given, but a guess of its class
OF_ABSOLUTE_POSES = 10.0  # further factor of poses of the flange, which err by the arm's absolute accuracy and not by its repeatability
REFUSED_BEYOND = 20.0  # ratio from which the result is of no use to anybody
MOST_REJECTED = 0.1  # of the centres: single outliers are an accident, so many have a cause


@dataclass(frozen=True)
class Contradiction(AsJson):
    """How far a fit is from the stated noise and the usual errors of an arm.

    Attributes
    ----------
    scanner, joint, link : float
        Ratios, root of the mean square over what is allowed.
    rejected : float
        Share of the centres that were rejected.
    cause : str
        A sentence, '' where none was found that explains it.
    misdescribed : bool
        Whether it is a sign, a unit or the like.
    """

    scanner: float
    joint: float
    link: float
    rejected: float
    cause: str = ""
    misdescribed: bool = False

    def beyond(self, cell: Cell) -> list[str]:
        """What is beyond what a cell may have, in words."""
        said = []
        if self.scanner > MOST_SCANNER * _doubt(cell.noise_mm):
            said.append(f"{self.scanner:.1f} times the scanner's {'stated' if cell.noise_mm is not None else 'usual'} noise")
        if self.joint > _joint_limit(cell):
            said.append(f"{self.joint:.1f} times the arm's {'stated' if cell.robot.repeatability_mm else 'usual'} repeatability")
        if self.link > MOST_LINK:
            said.append(f"{self.link:.1f} times the link errors that arms have")
        if self.rejected > MOST_REJECTED:
            said.append(f"{self.rejected:.0%} of the centres rejected")
        return said

    def sentence(self, cell: Cell) -> str:
        """The contradiction with its size, and its cause where that is known."""
        what = " and ".join(self.beyond(cell))
        if not what:
            return f"Something changed while the recording was made: {self.cause}"
        why = self.cause or "something is not as described, or not in the model: look at the recording before its result is used"
        return f"The recording contradicts its description ({what}): {why}"


def _doubt(stated: object) -> float:
    return UNSTATED if stated is None else 1.0


def _joint_limit(cell: Cell) -> float:
    absolute = OF_ABSOLUTE_POSES if cell.robot.of_flange_poses else 1.0
    return MOST_JOINT * absolute * _doubt(cell.robot.repeatability_mm)


def with_contradiction(cell: CalibratedCell) -> CalibratedCell:
    """The cell, with a warning where its recording contradicts its description.

    Raises CalibrationError where no result could be of use, if the options refuse anything. Poses of the flange may be off by more than an
    arm repeats, unless a wrong description of them is the cause.
    """
    found, of = contradiction(cell.adjustment), cell.fit.observations.cell
    if found is None:
        return cell
    absolute = of.robot.of_flange_poses and not found.misdescribed
    joint = found.joint / (OF_ABSOLUTE_POSES if absolute else 1.0)
    scanner = found.scanner / (1.0 if found.misdescribed else _doubt(of.noise_mm))
    if cell.fit.options.refuse and max(scanner, joint) > REFUSED_BEYOND:
        raise CalibrationError(found.sentence(of))
    return warned(cell, found.sentence(of), contradiction=found.to_dict())


def contradiction(adjustment: Adjustment) -> Contradiction | None:
    """The contradiction of a recording with a nominal arm; None where it is credible. adjustment: of hand-eye and stations, with the links'
    errors as random effects."""
    lineariser = at_allowed_sizes(adjustment.lineariser)
    noise = first_noise(lineariser.obs.cell)
    solution = solve(system(lineariser, adjustment.solution.estimate, noise, adjustment.weights), tolerance=1e-2)
    scanner, joint = noise_ratios(solution)
    link = link_ratio(solution, lineariser.layout)
    found = Contradiction(scanner, joint, link, float(np.mean(~adjustment.used)))
    strict = solve(solution, noise, every_pose(adjustment.weights), tolerance=1e-2)
    if found.beyond(lineariser.obs.cell):
        described = misdescribed(lineariser.obs) or wrong_length(lineariser.obs)
        return replace(found, cause=described or fault_of(strict), misdescribed=bool(described))
    fault = fault_of(strict, known=rejected_poses(adjustment))
    return replace(found, cause=fault) if fault else None


def every_pose(weights: Weights) -> Weights:
    """With the poses that were rejected: those after an accident may be few enough for that. Rejected centres stay out."""
    return weights if np.all(weights.pose == 1) else replace(weights, pose=np.ones_like(weights.pose))


def fault_while_recording(adjustment: Adjustment) -> str:
    """A sentence on a place, mount or joint that changed while an arm was recorded that is to be identified; '' where none explains the
    misfit, or where one pose does that was rejected already."""
    obs, solution, rejected = adjustment.lineariser.obs, adjustment.solution, rejected_poses(adjustment)
    if exchanged := exchanged_balls(obs):
        return exchanged
    if not rejected and not beyond_noise(solution, adjustment.stated_chi2):
        return ""  # the fit under that noise misses by even less
    noise = first_noise(obs.cell)
    return fault_of(solve(solution, noise, every_pose(adjustment.weights), tolerance=1e-2), known=rejected)


def rejected_poses(adjustment: Adjustment) -> list[int]:
    """Numbers of the poses that were rejected."""
    return adjustment.lineariser.obs.pose_id[adjustment.weights.pose == 0].tolist()


def at_allowed_sizes(lineariser: Lineariser) -> Lineariser:
    """The lineariser with link errors of the allowed size in place of the estimated one."""
    layout = parameters.build(lineariser.obs, lineariser.options).holding(lineariser.layout.held)
    return lineariser.with_layout(layout.resized(ORDINARY_LINKS))


def noise_ratios(solution: Solution) -> tuple[float, float]:
    """Ratios of the scanner's noise and of the joints', each over all its components.

    The ratio of a component k is y'P V_k P y / tr(P V_k), which is 1 in expectation under the noise of the solution (Patterson and Thompson
    1971). The score by log sigma is the difference of numerator and denominator.
    """
    joints = len(solution.noise.joint)
    score, _ = reml_score_and_information(solution.system, solution.noise)
    seen, moved = 0.0, 0.0
    for block in solution.poses.blocks:
        seen += float(np.sum(block.share[:, None, None] * block.white_residual[:, :3] ** 2))
        moved += float(np.sum(block.share[:, None] * block.residual_joint**2))
    return _root_ratio(seen, float(score[:3].sum())), _root_ratio(moved, float(score[3 : 3 + joints].sum()))


def _root_ratio(square: float, score: float) -> float:
    expected = square - score
    return float(np.sqrt(square / expected)) if expected > 0 else 0.0


def link_ratio(solution: Solution, layout: ParameterLayout) -> float:
    """The larger ratio of the groups of link errors: mean square of the estimates over what is expected of them under their prior."""
    covariance = np.linalg.inv(solution.normal.information)
    found = [0.0]
    for index in layout.sized.values():
        sigma, value = solution.prior.sigma[index], solution.prior.offset[index]
        determined = len(index) - float(np.sum(np.diag(covariance)[index] / sigma**2))  # how many of them the recording determines
        if determined > 0.5:
            found.append(float(np.sqrt(np.sum((value / sigma) ** 2) / determined)))
    return max(found)
