"""What is done with one recording of a fleet, and the row that comes of it; a broken recording is a row with its reason."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbcacq.errors import MbcacqError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.fleet.recordings import FleetRecording

FORMAT = "mbcacq-fleet-recording/1"
EVALUATED, REFUSED, FAILED = "evaluated", "refused", "failed"


@dataclass(frozen=True)
class FleetTask:
    """What is done with each recording: always calibrated, and verified at its own verification poses. diagnose: also sought for effects.
    verify: path of a result that is tried on it; '' for none. place: as ``mbcacq.verify_elsewhere`` takes it. options: of the
    calibration."""

    diagnose: bool = False
    verify: str = ""
    place: str = "fitted"
    options: CalibrationOptions = CalibrationOptions(random_links=False)  # arms and days are compared: no estimate may lean to nominal


def evaluate_recording(recording: FleetRecording, task: FleetTask) -> dict[str, Any]:
    """The content of the file of a recording: 'row' for the table, 'result' as result.json, 'diagnosis' where asked for.

    status of the row: 'evaluated', with what its calibration warned of as the reason; 'refused', with the reason, where the recording is
    broken or determines nothing; 'failed' where the program or the computer is at fault.
    """
    begin, used = time.perf_counter(), time.process_time()
    row: dict[str, Any] = {"recording": recording.path, "arm": recording.arm, "time": recording.time or None}
    content: dict[str, Any] = {"format": FORMAT}
    try:
        content |= _evaluated(recording, task, row)
        warned = (content.get("result") or {}).get("warnings") or ()
        row |= {"status": EVALUATED, "reason": "; ".join(warned) or None}
    except MbcacqError as error:
        row |= {"status": REFUSED, "reason": str(error)}
    except Exception as error:  # noqa: BLE001 - whatever is wrong with one recording, the others go on
        row |= {"status": FAILED, "reason": f"unexpected {type(error).__name__}: {error}"}
    row |= {"wall_s": time.perf_counter() - begin, "processor_s": time.process_time() - used}
    return content | {"row": row}


def _evaluated(recording: FleetRecording, task: FleetTask, row: dict[str, Any]) -> dict[str, Any]:
    """Fills the row step by step, so that what came before a refusal is kept."""
    from mbcacq.workflow.calibrate import calibration_content, verify_elsewhere
    from mbcacq.workflow.diagnose import diagnose
    from mbcacq.workflow.load import load_observations

    observations = load_observations(recording.path)
    row |= {"poses": observations.n_poses, "centres": observations.n_centres, "robot": observations.cell.robot.name}
    row["simulated"] = observations.cell.simulated
    result = calibration_content(recording.path, task.options, observations=observations)
    row |= calibration_columns(result)
    content: dict[str, Any] = {"result": result}
    if task.diagnose:
        found = diagnose(observations, workers=1, options=task.options)  # the cluster shares the recordings, not the folds
        content["diagnosis"] = found.to_dict()
        row |= {"verdict": found.verdict, "effects": [_effect(e) for e in content["diagnosis"]["effects"]]}
    if task.verify:
        transfer = verify_elsewhere(observations, task.verify, place=task.place).to_dict()
        content["transfer"] = transfer
        row |= {
            "transfer_rms_mm": transfer["with_effects"]["rms_mm"],
            "transfer_own_rms_mm": (transfer["own_geometry"] or {}).get("rms_mm"),
            "transfer_normalised_error": (transfer["normalised_error"] or {}).get("rms"),
        }
    return content


def calibration_columns(result: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of the table from the content of a result.json. Free parameters: 'error.NAME' and 'std.NAME' in mm or rad; ball centres,
    which belong to the artefact, are left out of them."""
    after = (result.get("verification") or {}).get("after") or {}
    columns: dict[str, Any] = {
        "nominal": [value for row in zip(*result["robot"]["nominal"].values(), strict=True) for value in row],
        "rms_mm": result["fit"]["rms_mm"],
        "chi2_dof": result["fit"]["chi2_dof"],
        "expected_accuracy_mm": result["fit"]["expected_accuracy_mm"],
        "spacing_max_mm": after.get("max_mm"),
        "spacing_mean_mm": after.get("mean_mm"),
        "scanner_noise_mm": max(result["noise"]["scanner_mm"]),
        "joint_noise_rad": max(result["noise"]["joint_rad"]),
        "rejected": len(result["rejected"]),
        "names": result["names"],
        "covariance": [value for row in result["covariance"] for value in row],
    }
    for p in result["parameters"]:
        if p["std"] is not None and not p["name"].startswith("ball_"):
            columns |= {f"error.{p['name']}": p["error"], f"std.{p['name']}": p["std"]}
    return columns


def _effect(effect: Mapping[str, Any]) -> str:
    return f"{effect['name']} at {'+'.join(effect['where'])}"
