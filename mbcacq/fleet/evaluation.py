"""What is done with one recording of a fleet, and the row that comes of it; a broken recording is a row with its reason."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbcacq.errors import MbcacqError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.fleet.recordings import FleetRecording
from mbcacq.fleet.row import EVALUATED, FAILED, REFUSED, FleetRow
from mbcacq.workflow.calibrate import calibration_content, verify_elsewhere
from mbcacq.workflow.diagnose import diagnose
from mbcacq.workflow.load import load_observations

FORMAT = "mbcacq-fleet-recording/1"


@dataclass(frozen=True)
class FleetTask:
    """What is done with each recording. It is always calibrated, and verified at its own verification poses.

    Attributes
    ----------
    diagnose
        Also search for effects.
    verify
        Path of a result that is tried on the recording; '' for none.
    place
        As ``mbcacq.verify_elsewhere`` takes it.
    options
        Options of the calibration.
    """

    diagnose: bool = False
    verify: str = ""
    place: str = "fitted"
    options: CalibrationOptions = CalibrationOptions(random_links=False)  # arms and days are compared: no estimate may lean to nominal


def evaluate_recording(recording: FleetRecording, task: FleetTask) -> tuple[FleetRow, dict[str, Any]]:
    """The row of a recording for the table, and the content of its file: 'result' as result.json, 'diagnosis' and 'transfer' where asked
    for.

    status of the row: 'evaluated', with the warnings of its calibration as the reason; 'refused', with the reason, if the recording is
    broken or determines nothing. It is 'failed' if the program or the computer is at fault.
    """
    begin, used = time.perf_counter(), time.process_time()
    row = FleetRow(recording=recording.path, arm=recording.arm, time=recording.time or None)
    content: dict[str, Any] = {}
    try:
        content = _evaluated(recording, task, row)
        row.status, row.reason = EVALUATED, "; ".join(content["result"].get("warnings") or ()) or None
    except MbcacqError as error:
        row.status, row.reason = REFUSED, str(error)
    except Exception as error:  # noqa: BLE001 - whatever is wrong with one recording, the others go on
        row.status, row.reason = FAILED, f"unexpected {type(error).__name__}: {error}"
    row.wall_s, row.processor_s = time.perf_counter() - begin, time.process_time() - used
    return row, content


def _evaluated(recording: FleetRecording, task: FleetTask, row: FleetRow) -> dict[str, Any]:
    """Fills the row step by step, so that what came before a refusal is kept."""
    observations = load_observations(recording.path)
    row.poses, row.centres = observations.n_poses, observations.n_centres
    row.robot, row.simulated = observations.cell.robot.name, observations.cell.simulated
    content: dict[str, Any] = {"result": calibration_content(recording.path, task.options, observations=observations)}
    _take_calibration(row, content["result"])
    if task.diagnose:
        found = diagnose(observations, workers=1, options=task.options)  # the cluster shares the recordings, not the folds
        content["diagnosis"] = found.to_dict()
        row.verdict = found.verdict
        row.effects = tuple(f"{e['name']} at {'+'.join(e['where'])}" for e in content["diagnosis"]["effects"])
    if task.verify:
        transfer = verify_elsewhere(observations, task.verify, place=task.place)
        content["transfer"] = transfer.to_dict()
        row.transfer_rms_mm = transfer.with_effects.rms_mm
        row.transfer_own_rms_mm = transfer.own_geometry and transfer.own_geometry.rms_mm
        row.transfer_normalised_error = transfer.normalised_error and transfer.normalised_error.rms
    return content


def _take_calibration(row: FleetRow, result: Mapping[str, Any]) -> None:
    """Fills the columns that follow from the content of a result.json."""
    after = (result.get("verification") or {}).get("after") or {}
    fit, noise = result["fit"], result["noise"]
    row.nominal = tuple(value for joint in zip(*result["robot"]["nominal"].values(), strict=True) for value in joint)
    row.rms_mm, row.chi2_dof, row.expected_accuracy_mm = fit["rms_mm"], fit["chi2_dof"], fit["expected_accuracy_mm"]
    row.spacing_max_mm, row.spacing_mean_mm = after.get("max_mm"), after.get("mean_mm")
    slides, row.axes = result["robot"].get("sliding", ()), tuple(result["robot"].get("axes", ()))
    row.scanner_noise_mm = max(noise["scanner_mm"])
    row.joint_noise_rad = max((v for i, v in enumerate(noise["joint_rad"]) if i not in slides), default=None)
    row.rejected, row.names = len(result["rejected"]), tuple(result["names"])
    row.covariance = tuple(value for line in result["covariance"] for value in line)
    row.estimates = {
        p["name"]: (p["error"], p["std"]) for p in result["parameters"] if p["std"] is not None and not p["name"].startswith("ball_")
    }
