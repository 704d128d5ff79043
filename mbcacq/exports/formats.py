"""The formats that come with the program."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbcacq.estimation.parameters import HAND_EYE
from mbcacq.exports import joint_frames, kuka, mjcf, ros, tables, urdf
from mbcacq.exports.format import ExportedResult, ExportFormat, Targets
from mbcacq.exports.marks import mjcf_comments, with_comments
from mbcacq.exports.result_json import result_schema
from mbcacq.model.json_text import sealed_text
from mbcacq.recording.datasets import quaternions

TARGET_TOOL = "mbcacq target"


class ResultJson(ExportFormat):
    name = "result"
    summary = "the result as JSON with its schema, and the hand-eye transform with its covariance, for programs"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        files = {"result.json": sealed_text(exported.result), "result.schema.json": json.dumps(result_schema(), indent=1)}
        if exported.known_mount is not None:
            files["hand_eye.json"] = json.dumps(_hand_eye(exported, exported.known_mount), indent=1) + "\n"
        return files


def _hand_eye(exported: ExportedResult, T: np.ndarray) -> dict[str, Any]:
    """The frame on the flange with its covariance, for programs that need nothing else."""
    names = [f"hand_eye.{c}" for c in HAND_EYE]
    at = {name: i for i, name in enumerate(exported.result["names"]) if name in names}
    known, covariance = np.array(exported.result["covariance"], dtype=float), np.zeros((6, 6))
    free = [names.index(name) for name in at]
    covariance[np.ix_(free, free)] = known[np.ix_(list(at.values()), list(at.values()))] if at else 0.0
    w, x, y, z = quaternions.from_matrix(T[:3, :3]).tolist()
    simulated = {"simulated": True} if exported.result.get("simulated") else {}
    return {
        "format": "mbcacq-hand-eye/1",
        **simulated,
        "parent": exported.targets.flange_frame,
        "child": exported.mounted_frame,
        "T_parent_child_mm": T.tolist(),
        "translation_mm": T[:3, 3].tolist(),
        "quaternion_xyzw": [x, y, z, w],
        "covariance": covariance.tolist(),
        "notes": exported.comments,
        "covariance_of": "x, y, z in mm and rotation vector in rad of a small motion of the child, in its own frame (k = 1)",
    }


class Spreadsheets(ExportFormat):
    name = "csv"
    summary = "parameters, covariance, verification, residuals and the tool frame of each make as CSV, for spreadsheets"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        result, observations = exported.result, exported.observations
        files: dict[str, str | bytes] = {
            "parameters.csv": tables.parameters_csv(result),
            "covariance.csv": tables.covariance_csv(result),
            "verification.csv": tables.verification_csv(result),
        }
        if exported.known_mount is not None:
            files["tool_frames.csv"] = tables.tool_frames_csv(result, exported.known_mount)
        if observations is not None:
            files["residuals.csv"] = tables.residuals_csv(result, observations)
        return files


class KukaTool(ExportFormat):
    name = "kuka"
    summary = "TOOL_DATA of a KUKA controller, and a diff against its $config.dat"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        targets = exported.targets
        T = exported.T_flange_scanner
        name = TARGET_TOOL if exported.of_target and targets.tool_name == Targets.tool_name else targets.tool_name
        files: dict[str, str | bytes] = {"tool_data.txt": kuka.tool_data(T, targets.tool, name)}
        if targets.config_dat is not None:
            difference = kuka.config_diff(targets.config_dat, T, targets.tool, name)
            files["config.dat.diff"] = with_comments("config.dat.diff", difference, exported.comments).encode("latin-1")
        return files


class Ros(ExportFormat):
    name = "ros"
    summary = "the hand-eye transform for easy_handeye2, TF and URDF, and the kinematics as ROS parameters"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        t = exported.targets
        files: dict[str, str | bytes] = {}
        if exported.has_joints:
            files["kinematics.yaml"] = joint_frames.kinematics_yaml(exported.chains[1], exported.robot_name)
        for number, (name, T) in enumerate(exported.instruments.items()):
            scanner = t.scanner_frame if number == 0 else f"{t.scanner_frame}_{number + 1}"
            stem = t.name if number == 0 else f"{t.name}_{number + 1}"
            files |= _ros_frame(T, t, stem, t.base_frame, scanner, f"instrument '{name}'", exported.comments)
        if not exported.of_target and exported.known_mount is not None:
            files |= _ros_frame(exported.T_flange_scanner, t, t.name, t.flange_frame, t.scanner_frame, "", exported.comments)
        return files


def _ros_frame(T: np.ndarray, t: Targets, stem: str, parent: str, scanner: str, instrument: str, comments: Sequence[str]) -> dict[str, str]:
    """Hand-eye file, launch file and command of one frame. instrument: what stands in the base, or '' for the scanner on the flange."""
    tail = stem.removeprefix(t.name)
    kept = ros.hand_eye_yaml(T, name=stem, base=t.base_frame, flange=t.flange_frame, scanner=scanner, fixed=bool(instrument))
    return {
        f"{stem}.calib": f"# {instrument}\n{kept}" if instrument else kept,
        f"scanner{tail}.launch.py": ros.launch_file(T, parent, scanner),
        f"scanner{tail}.urdf.xacro": ros.urdf_fragment(T, parent, scanner, comments),
        f"static_transform{tail}.sh": "#!/bin/sh\nexec " + ros.static_transform_command(T, parent, scanner) + "\n",
    }


class Mjcf(ExportFormat):
    name = "mjcf"
    summary = "the arm as a MuJoCo model, with the effects that such a model can hold"
    of_joints = True

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        lines, name = mjcf_comments(exported.result), exported.robot_name or "arm"
        site = "target" if exported.of_target else "scanner"
        return {"arm.mjcf.xml": mjcf.mjcf(exported.chains[1], exported.known_mount, name, lines, exported.effects, site=site)}


class Urdf(ExportFormat):
    name = "urdf"
    summary = "a calibrated copy of the URDF or xacro that is given by --urdf"
    of_joints = True

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        t = exported.targets
        if t.urdf is None:
            return {}
        joints = t.joints or None
        where = {"T_flange_scanner": exported.known_mount, "scanner": exported.mounted_frame}
        return {t.urdf.name: urdf.patch(t.urdf, *exported.chains, joints=joints, comments=exported.comments, **where)}
