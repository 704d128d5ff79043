"""All the formats of one result, written into a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration import state_from_dict
from mbcacq.calibration.result_io import effects_of
from mbcacq.calibration.sealed_json import sealed_text
from mbcacq.exports import joint_frames, kuka, mjcf, ros, tables, urdf
from mbcacq.exports.marks import comments, mjcf_comments, with_comments
from mbcacq.exports.result_json import result_schema
from mbcacq.files.atomic_write import write_files
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class Targets:
    """What is wanted beyond CSV and JSON. tool: number on the KUKA controller; config_dat: its $config.dat, for a diff; urdf: file to
    patch, with the names of its moving joints, or () for all; flange_frame, scanner_frame, base_frame, name: names in ROS.
    """

    tool: int = 1
    tool_name: str = "mbcacq scanner"
    config_dat: Path | None = None
    urdf: Path | None = None
    joints: Sequence[str] = ()
    flange_frame: str = "tool0"
    scanner_frame: str = "scanner_frame"
    base_frame: str = "base_link"
    name: str = "mbcacq"


def chains(result: Mapping[str, Any]) -> tuple[Chain, Chain]:
    """Nominal and calibrated arm of a result."""
    sign = np.array(result["robot"]["sign"], dtype=float)
    nominal, calibrated = (
        Chain(sign, *(np.array(result["robot"][which][p], dtype=float) for p in PARAMETERS)) for which in ("nominal", "calibrated")
    )
    return nominal, calibrated


def contents(result: Mapping[str, Any], targets: Targets, observations: Observations | None = None) -> dict[str, bytes]:
    """File name -> content. Raises ConfigError where a target does not fit, before anything is written."""
    T, marks = state_from_dict(dict(result)).T_flange_scanner, comments(result)
    text = {
        "result.json": sealed_text(result),
        "result.schema.json": json.dumps(result_schema(), indent=1),
        "parameters.csv": tables.parameters_csv(result),
        "covariance.csv": tables.covariance_csv(result),
        "verification.csv": tables.verification_csv(result),
        "tool_data.txt": kuka.tool_data(T, targets.tool, targets.tool_name),
        f"{targets.name}.calib": ros.hand_eye_yaml(
            T, name=targets.name, base=targets.base_frame, flange=targets.flange_frame, scanner=targets.scanner_frame
        ),
        "scanner.launch.py": ros.launch_file(T, targets.flange_frame, targets.scanner_frame),
        "kinematics.yaml": joint_frames.kinematics_yaml(chains(result)[1], str(result["robot"].get("name", ""))),
        "arm.mjcf.xml": mjcf.mjcf(chains(result)[1], T, str(result["robot"].get("name", "arm")), mjcf_comments(result), effects_of(result)),
        "static_transform.sh": "#!/bin/sh\nexec " + ros.static_transform_command(T, targets.flange_frame, targets.scanner_frame) + "\n",
    }
    text = {name: with_comments(name, content, marks) for name, content in text.items()}
    if observations is not None:
        text["residuals.csv"] = tables.residuals_csv(result, observations)
    files = {name: content.encode("utf-8") for name, content in text.items()}
    if targets.config_dat is not None:
        difference = kuka.config_diff(targets.config_dat, T, targets.tool, targets.tool_name)
        files["config.dat.diff"] = with_comments("config.dat.diff", difference, marks).encode("latin-1")
    if targets.urdf is not None:
        files[targets.urdf.name] = urdf.patch(
            targets.urdf, *chains(result), joints=targets.joints or None, T_flange_scanner=T, scanner=targets.scanner_frame, comments=marks
        )
    return files


def write_folder(files: Mapping[str, bytes], folder: Path) -> list[Path]:
    """Write the files. Raises RecordingError where that fails."""
    return write_files(folder, files)
