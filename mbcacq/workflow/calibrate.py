"""Calibrate, verify and compare, on observations in memory or from a file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration import calibrate as calibration
from mbcacq.calibration import calibrated_cell, several
from mbcacq.calibration.calibrate import calibrate_with_effects
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.compare_methods import Comparison
from mbcacq.calibration.compare_methods import compare as compare_methods
from mbcacq.calibration.cross_validation import held_out as cross_validate
from mbcacq.calibration.result_io import joint_content as content_of_all
from mbcacq.calibration.staged.angle_adjustment import LCurve
from mbcacq.calibration.sufficiency import FLANGE_POSES_ALONE, HAND_EYE_ALONE, options_for
from mbcacq.calibration.transfer import Transfer, check_transfer
from mbcacq.calibration.verification import Verification
from mbcacq.calibration.workspace_accuracy import accuracy_map
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.exports.result_json import load_result
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.workflow.effects import Effects, as_effects
from mbcacq.workflow.load import as_observations, counted_joints

MOVED_MM = 2.0  # rms with places known, above which it is asked whether they were moved: more than any arm's own errors
MOVED_SHARE = 0.1  # of that rms: what is left with the places fitted, where the arm is the learnt one
BUMPED_CHI2 = 2.0  # per degree of freedom with places known, above which it is asked; noise alone gives 1
BUMPED_SHARE = 0.5  # of that chi2: what is left with the places fitted, where they were moved a little


def calibrate(
    data: Observations | Path | str,
    options: CalibrationOptions | None = None,
    *,
    effects: Effects | None = None,
    hold_effects: bool = False,
) -> CalibratedCell:
    """Identify the cell: MD-H errors of the arm, hand-eye transform, stations, ball centres and noise.

    Parameters
    ----------
    data
        Observations, or where they are (see ``mbcacq.load_observations``). Poses of phase 'verification' are kept apart.
    options
        Method, phases, held parameters, noise model.
    effects
        What ``mbcacq.diagnose`` found (or its JSON file, or a list of these). The effects become terms of the cell.
    hold_effects
        Keep the coefficients of the effects as they are; by default they are fitted with everything else.

    Returns
    -------
    CalibratedCell
        ``errors`` (n, 5) in rad and mm, ``state.T_flange_scanner`` (4, 4), covariance, noise.

    Raises
    ------
    CalibrationError
        The poses leave something undetermined, which the message names.
    ConfigError
        The options do not fit the data.

    Examples
    --------
    >>> cell = mbcacq.calibrate("runs/today")
    >>> cell.to_base(q, xyz)  # (P, 3) mm: scanner points in the base frame
    """
    if effects is None:
        return calibration.calibrate(as_observations(data), options)
    return calibrate_with_effects(as_observations(data), options, as_effects(effects), hold=hold_effects)


def calibrate_together(
    data: Sequence[Observations | Path | str],
    options: CalibrationOptions | None = None,
    *,
    effects: Effects | None = None,
    hold_effects: bool = False,
) -> tuple[CalibratedCell, ...]:
    """Calibrate several recordings of one arm as one problem.

    The recordings share the arm and its effects. Base, tool, stations, artefacts and noise belong to each recording.

    Parameters
    ----------
    data
        The recordings, each as ``calibrate`` takes it.
    options
        As for ``calibrate``.
    effects, hold_effects
        As for ``calibrate``. A coefficient that differs from day to day gets a variance between recordings.

    Returns
    -------
    tuple of CalibratedCell
        One cell for each recording, in their order, with the covariance that all of them together give.

    Raises
    ------
    ConfigError
        The recordings are not of one arm.
    CalibrationError
        As ``calibrate``.
    """
    recordings = [as_observations(one) for one in data]
    model = None if effects is None else as_effects(effects)
    return several.calibrate_together(recordings, options, model, hold=hold_effects)


def verify(
    data: Observations | Path | str,
    calibrated: CalibratedCell | CellState | Path | str,
    *,
    before: CellState | None = None,
    limit_mm: float | None = None,
) -> Verification:
    """Sphere spacing errors at the verification poses, before and after calibration.

    Parameters
    ----------
    data
        The recording, as ``calibrate`` takes it.
    calibrated
        What ``mbcacq.calibrate`` returned, or a result.json, or a run folder that holds one. A bare
        ``mbcacq.estimation.forward_model.CellState`` is compared with ``before``.
    before
        The cell before calibration; only with a bare ``CellState``.
    limit_mm
        Largest error permitted, mm.

    Returns
    -------
    Verification
        Errors in mm, each with the uncertainty that is expected of it and that of judging it.

    Raises
    ------
    ConfigError
        The recording is of another arm.
    """
    if isinstance(calibrated, Path | str):
        calibrated = CalibratedCell.from_json(Path(calibrated))
    return calibrated_cell.verify(as_observations(data), calibrated, before=before, limit_mm=limit_mm)


def verify_elsewhere(data: Observations | Path | str, calibrated: CalibratedCell | Path | str, *, place: str = "fitted") -> Transfer:
    """Try a calibrated arm, with its effects, on a recording to which it was not fitted. Both stay as they were learnt.

    Parameters
    ----------
    data
        The other recording.
    calibrated
        A calibrated cell, a result.json, or a run folder that holds one.
    place
        'fitted': base, tool and stations of that recording are fitted to it. 'known': nothing is fitted, and poses at stations that the
        calibrated cell does not have are left out.

    Returns
    -------
    Transfer
        Errors in mm and chi2 per degree of freedom, with the learnt geometry alone and with the effects; the gain of each effect.

    Raises
    ------
    ConfigError
        The recording is of another arm (name or nominal links), or none of its stations is known.
    CalibrationError
        The recording does not determine its own places, or its artefacts were moved from where they are known to be.
    """
    cell = calibrated
    if isinstance(cell, Path | str):
        cell = CalibratedCell.from_json(Path(cell), any_of_them=place == "fitted")
    alone = cell.extra.get("geometry_alone")
    chain = None
    if alone:
        chain = cell.state.chain.with_rows(np.array([alone["calibrated"][p] for p in PARAMETERS]).T)
    name = str(data) if isinstance(data, Path | str) else ""
    observations = as_observations(data)
    found = check_transfer(observations, cell, chain, place=place, recording=name)
    if place == "known" and found.with_effects.chi2_dof > BUMPED_CHI2:
        return _moved_or_not(found, observations, lambda: check_transfer(observations, cell, chain, place="fitted", recording=name))
    return found


def _moved_or_not(known: Transfer, observations: Observations, fit: Callable[[], Transfer]) -> Transfer:
    """The trial, with a warning where the arm is the learnt one and what stands around it is elsewhere.

    Raises CalibrationError where that is so far away that no figure says anything of the arm.
    """
    far = known.with_effects.rms_mm
    try:
        fitted = fit()
    except CalibrationError:  # the recording does not determine its own places
        return known
    near = fitted.with_effects.rms_mm
    what = "the instrument or the robot's base" if observations.cell.measurement == TARGET_IN_BASE else "the artefacts or the robot's base"
    figures = f"{near:.3g} mm is left with their places fitted, {far:.3g} mm where they are known; use --place fitted"
    if far > MOVED_MM and near <= MOVED_SHARE * far:
        raise CalibrationError(f"{known.recording or 'the recording'}: {what} were moved since the result was made: {figures}")
    if fitted.with_effects.chi2_dof > BUMPED_SHARE * known.with_effects.chi2_dof:
        return known
    return replace(known, warnings=(f"{what} seem to have been moved a little since the result was made: {figures}", *known.warnings))


def compare(
    data: Observations | Path | str,
    methods: Iterable[str] | None = None,
    *,
    held_out: bool = True,
    seed: int = 0,
    progress: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Calibrate a recording by several methods and compare their errors.

    Parameters
    ----------
    data
        The recording, as ``calibrate`` takes it.
    methods
        Names of the methods; all by default.
    held_out
        Whether held-out errors are computed too, which takes further fits.
    seed
        Seed of the split into folds.
    progress
        Called with a sentence for each method.

    Returns
    -------
    Comparison
        One row for each method: fit, sphere spacing error, held-out error, all in mm. A method that these data do not determine has the
        reason instead of figures.

    Raises
    ------
    CalibrationError
        No method is determined.
    """
    return compare_methods(as_observations(data), methods, held_out=held_out, seed=seed, progress=progress)


def calibration_content(
    data: Path | str,
    options: CalibrationOptions,
    *,
    held_out: Mapping[str, Any] | None = None,
    with_map: bool = False,
    effects: Effects | None = None,
    hold_effects: bool = False,
    observations: Observations | None = None,
) -> dict[str, Any]:
    """Calibrate a recording and verify it; the content of result.json with 'verification' and 'gaps', with 'accuracy_map' and 'held_out'
    where asked for. held_out: arguments of ``cross_validation.held_out``. observations: where they have been read from ``data`` already. A
    plan without the phase 'position' is calibrated for what its run calibrates (``options_for``).

    Raises CalibrationError, ConfigError.
    """
    if effects is not None and held_out is not None:
        raise ConfigError("held-out figures are of the geometry alone; try a calibration with effects on another recording: mbcacq verify")
    observations = as_observations(data) if observations is None else observations
    asked, options = options, options_for(observations, options)
    cell = calibrate(observations, options, effects=effects, hold_effects=hold_effects)
    content = cell.to_dict()
    content["verification"] = cell.verify(observations, limit_mm=limit_of(Path(data))).to_dict()
    content["gaps"] = [*find_gaps(Path(data)), *observations.understood]
    content |= counted_joints(Path(data), observations.cell.robot.n)
    if asked.kinematics and not options.kinematics:
        content["scope"] = FLANGE_POSES_ALONE if observations.cell.robot.of_flange_poses else HAND_EYE_ALONE
    if with_map:
        content["accuracy_map"] = accuracy_map(cell, cell.fit.observations).to_dict()
    if held_out is not None:
        content["held_out"] = cross_validate(observations, options, **held_out).to_dict()
    return content


def limit_of(run: Path) -> float | None:
    """The limit of the sphere spacing error, mm, that a run was judged by; None where it has none."""
    if not (run / "result.json").is_file():
        return None

    return (load_result(run).get("verification") or {}).get("limit_mm")


def joint_content(
    data: Sequence[Path], options: CalibrationOptions, *, effects: Effects | None = None, hold_effects: bool = False
) -> dict[str, Any]:
    """Calibrate several recordings of one arm together and verify each; content of format 'mbcacq-joint-result/1', with 'verification' and
    'gaps' in the result of each. Raises CalibrationError, ConfigError.
    """
    cells = calibrate_together(data, options, effects=effects, hold_effects=hold_effects)
    content = content_of_all([cell.to_dict() for cell in cells], [str(path) for path in data])
    for path, cell, one in zip(data, cells, content["recordings"], strict=True):
        one["result"]["verification"] = cell.verify(as_observations(path)).to_dict()
        one["result"]["gaps"] = find_gaps(path)
        one["result"] |= counted_joints(Path(path), cell.nominal.n)
    return content


def draw_l_curve(content: dict[str, Any], path: Path) -> None:
    """The L-curve of a staged calibration as an HTML page. Raises ConfigError where the method has none."""
    curve = next((s["l_curve"] for s in content.get("stages", ()) if "l_curve" in s), None)
    if curve is None:
        raise ConfigError("there is no L-curve: it belongs to the angle adjustment of --method paper")
    LCurve(np.array(curve["ridge"]), np.array(curve["misfit_rad"]), np.array(curve["size_mm"]), curve["corner"]).plot(path)
