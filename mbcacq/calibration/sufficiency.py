"""What a recording can determine: its scope, and refusals with a sentence that says what is missing, or that it is of another arm.

A plan before it is executed, a run at its end and a calibration of its recording ask the same functions, and so give the same verdict.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.model.cell import SCENE, TARGET_IN_BASE, RobotModel
from mbcacq.model.observations import Observations
from mbcacq.quantities import DEGREE, K, from_degrees, in_degrees, uncertainty

POOR_MM, POOR_ALONE_MM = 1.0, 0.1  # of a point in the workspace; an arm of this class is as good as the first without calibration
RUNAWAY_MM, RUNAWAY_RAD = 5.0, 1.0 * DEGREE  # ten times the errors of an arm as it is delivered
LEAST_ROTATION = 4.0 * DEGREE
RADIANS_AS_DEG = from_degrees(2 * np.pi)  # of joint angles: a full turn in radians, read as degrees
FIRST_LOOK = 64  # poses of which a few degrees of rotation are looked for first
HAND_EYE_ALONE = (
    "all poses are at one station, which leaves the arm's geometry undetermined elsewhere: the hand-eye transform alone is calibrated, "
    "the arm is taken as nominal; for the arm, put the artefact at more places, at different heights and distances (phase 'position')"
)


FLANGE_POSES_ALONE = (
    "the poses are given by the flange and not by joint angles: the hand-eye transform alone is calibrated, and the errors of the "
    "arm's links are noise of these poses; for the arm, give joint angles"
)


def options_for(obs: Observations, options: CalibrationOptions) -> CalibrationOptions:
    """The options with the scope that the poses are meant for. obs: recorded, or as planned.

    Poses of phase 'position', and poses without phases, are meant to determine the whole cell: nothing changes. Without that phase, poses
    at one station determine the hand-eye transform alone; at several stations, what they leave open is held, and the standard deviations
    show it; poses of one orientation leave too much open. Options that hold the arm or refuse nothing already, and those of the published
    method, stay.
    """
    if obs.cell.robot.of_flange_poses:
        return replace(options, kinematics=False)
    if options.method != "ml" or not (options.kinematics and options.refuse) or obs.phase is None or "position" in obs.phase:
        return options
    if at_one_station(select_phases(obs, options)):
        if any(artefact.id == SCENE for artefact in obs.cell.artefacts):
            return replace(options, refuse=False)  # its scans are to fit each other, which takes the arm's errors as far as they show
        return replace(options, kinematics=False)
    turned = orientation_range(obs, enough=LEAST_ROTATION) >= LEAST_ROTATION
    return replace(options, refuse=False) if turned else options


def refuse_insufficient(obs: Observations, options: CalibrationOptions) -> None:
    """Raise CalibrationError where the poses to fit cannot determine what the options ask for, as far as that is known before solving."""
    refuse_degenerate(obs, options)
    if options.kinematics and options.refuse:
        refuse_one_station(obs)


def refuse_unknown_arm(obs: Observations, options: CalibrationOptions) -> None:
    """Raise CalibrationError where the arm's links are to be identified from poses of the flange."""
    if options.kinematics and obs.cell.robot.of_flange_poses:
        raise CalibrationError(
            "the poses are given by the flange and not by joint angles, which leaves the arm's links undetermined; identify the hand-eye "
            "transform alone (--hand-eye-only; kinematics=False in Python), or give the joint angles"
        )


def refuse_degenerate(obs: Observations, options: CalibrationOptions) -> None:
    """Raise CalibrationError where it can be said before solving: too few balls, poses or orientations."""
    per_station = obs.cell.measurement != TARGET_IN_BASE
    if per_station:
        _refuse_few_balls(obs, not options.kinematics)
    turn = orientation_range(obs, enough=LEAST_ROTATION)
    if turn < LEAST_ROTATION and not obs.cell.robot.of_flange_poses and float(np.abs(obs.q).max(initial=0.0)) < RADIANS_AS_DEG:
        raise CalibrationError(
            f"no joint angle exceeds {in_degrees(RADIANS_AS_DEG):.2g}°, and all poses of a station have the same orientation (within "
            f"{in_degrees(turn):.1f}°): they look like radians; give joint angles in degrees"
        )
    if turn < LEAST_ROTATION and options.refuse and not {"hand_eye.x", "hand_eye.y", "hand_eye.z"} <= set(options.hold):
        raise CalibrationError(
            f"at every station all poses have the same orientation (within {in_degrees(turn):.1f}°), which leaves "
            "the hand-eye translation undetermined; add poses that tilt and turn the scanner by 20° and more"
        )
    place = 3 if obs.width == 1 else 6
    unknowns = place + place * len(np.unique(obs.station)) + (4 * obs.cell.robot.n - 6 if options.kinematics else 0)
    rows = obs.n_centres * obs.width
    if rows < unknowns:
        raise CalibrationError(f"{obs.n_centres} measured centres give {rows} coordinates for {unknowns} unknowns; measure more poses")


def refuse_one_station(obs: Observations) -> None:
    """Raise CalibrationError where all poses are at one station: its own pose absorbs what the arm does wrong there, and the fit looks
    better than it is anywhere else. A station whose place in the base is given counts as two."""
    if at_one_station(obs):
        raise CalibrationError(
            "all poses are at one station, which leaves the arm's geometry undetermined elsewhere; put the artefact at "
            "more places, at different heights and distances, or identify the hand-eye transform alone"
        )


def at_one_station(obs: Observations) -> bool:
    """Whether all poses are at one station whose place in the base is not given."""
    used = np.unique(obs.station)
    return obs.cell.measurement != TARGET_IN_BASE and len(used) == 1 and obs.cell.stations[used[0]].T_base_station is None


def _refuse_few_balls(obs: Observations, hand_eye_alone: bool) -> None:
    """At least one station must have shown three balls of its artefact, or all where it has fewer; for the hand-eye alone one is enough."""
    for s in np.unique(obs.station):
        artefact = obs.cell.artefact(obs.cell.stations[s].artefact)
        measured = len(np.unique(obs.ball[obs.station[obs.pose] == s]))
        if measured >= min(3, len(artefact.ball_ids)) or obs.rotation is not None or hand_eye_alone:
            return
    raise CalibrationError(
        "fewer than three balls of the artefact were seen at every station, which leaves the orientation of the "
        "stations undetermined; show at least three balls that are not on one line"
    )


def refuse_poor(layout: ParameterLayout, C: np.ndarray, expected_mm: float, obs: Observations, options: CalibrationOptions) -> None:
    """Raise CalibrationError where everything is determined in principle, but so poorly that the result would be of no use.

    C: (g, g) covariance of the free parameters; expected_mm: rms uncertainty of a point over the workspace.
    """
    alone = len(np.unique(obs.station)) == 1 and obs.cell.measurement != TARGET_IN_BASE
    limit = POOR_ALONE_MM if alone else POOR_MM
    if expected_mm < limit or not (options.refuse and options.kinematics):
        return
    size = np.where(np.isfinite(layout.sigma), 0.0, np.sqrt(np.diag(C)) / layout.scale)
    named = ", ".join(layout.names[i] for i in np.argsort(-size)[:4])
    advice = (
        "all poses are at one station: put the artefact at more places, at different heights and distances"
        if alone
        else "add stations at other places and poses with larger tilt"
    )
    raise CalibrationError(
        f"these poses would leave a point in the workspace uncertain by U = {uncertainty(K * expected_mm)} mm (k = 2), worst "
        f"determined are {named}; {advice}, or identify the hand-eye transform alone"
    )


def orientation_range(obs: Observations, enough: float = np.inf) -> float:
    """Largest angle (rad) between the flange orientation of a pose and that of the first pose of the same station; if the first poses alone
    reach ``enough``, only these count."""
    largest, first = 0.0, np.zeros(len(obs.cell.stations), int)
    first[obs.station[::-1]] = np.arange(obs.n_poses)[::-1]
    for poses in np.split(np.arange(obs.n_poses), [FIRST_LOOK]):
        both, here = np.unique(np.concatenate([poses, first[obs.station[poses]]]), return_inverse=True)
        R = obs.cell.robot.chain.flange(obs.q[both])[here, :3, :3]
        turn = np.swapaxes(R[len(poses) :], 1, 2) @ R[: len(poses)]
        cosine = (np.trace(turn, axis1=1, axis2=2) - 1) / 2
        largest = max(largest, float(np.arccos(np.clip(cosine.min(initial=1.0), -1.0, 1.0))))
        if largest >= enough:
            break
    return largest


def refuse_runaway(chain: Chain, nominal: Chain, options: CalibrationOptions) -> None:
    """Raise CalibrationError where MD-H parameters went where no arm is built: a method without a noise model cannot tell that itself."""
    errors = np.abs(chain.rows - nominal.rows)
    far = errors > np.array([RUNAWAY_RAD, RUNAWAY_MM, RUNAWAY_MM, RUNAWAY_RAD, RUNAWAY_RAD])
    if not far.any() or not options.refuse:
        return
    link, parameter = np.argwhere(far)[0]
    raise CalibrationError(
        f"the poses do not hold the arm's size: {PARAMETERS[parameter]}_{link + 1} ran away from its nominal value; "
        "let the artefact appear in different corners of the view, and add poses with larger translations"
    )


def refuse_other_arm(learnt: str, name: str, nominal: Chain, robot: RobotModel, other: str) -> None:
    """Raises ConfigError if ``robot`` has another name or other nominal links than the arm learnt on, which is ``nominal`` as described.

    learnt: what was learnt, as in 'the result is of'; other: what it is to be applied to, as in 'the recording'.
    """
    if robot.name == name and robot.chain.same_links(nominal):
        return
    links = ", other nominal links" if robot.name == name and robot.n == nominal.n else ""
    raise ConfigError(
        f"{learnt} '{name}' ({nominal.n} axes), and {other} is of '{robot.name}' ({robot.n} axes{links}); "
        "give what was learnt on the same arm"
    )
