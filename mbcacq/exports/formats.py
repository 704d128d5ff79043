"""The formats that come with the program."""

from __future__ import annotations

import json
from collections.abc import Mapping

from mbcacq.calibration.sealed_json import sealed_text
from mbcacq.exports import joint_frames, kuka, mjcf, ros, tables, urdf
from mbcacq.exports.format import ExportedResult, ExportFormat
from mbcacq.exports.marks import mjcf_comments, with_comments
from mbcacq.exports.result_json import result_schema


class ResultJson(ExportFormat):
    name = "result"
    summary = "the result as JSON with its schema, for programs"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        return {"result.json": sealed_text(exported.result), "result.schema.json": json.dumps(result_schema(), indent=1)}


class Spreadsheets(ExportFormat):
    name = "csv"
    summary = "parameters, covariance, verification and residuals as CSV, for spreadsheets"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        result, observations = exported.result, exported.observations
        files: dict[str, str | bytes] = {
            "parameters.csv": tables.parameters_csv(result),
            "covariance.csv": tables.covariance_csv(result),
            "verification.csv": tables.verification_csv(result),
        }
        if observations is not None:
            files["residuals.csv"] = tables.residuals_csv(result, observations)
        return files


class KukaTool(ExportFormat):
    name = "kuka"
    summary = "TOOL_DATA of a KUKA controller, and a diff against its $config.dat"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        T, targets = exported.T_flange_scanner, exported.targets
        files: dict[str, str | bytes] = {"tool_data.txt": kuka.tool_data(T, targets.tool, targets.tool_name)}
        if targets.config_dat is not None:
            difference = kuka.config_diff(targets.config_dat, T, targets.tool, targets.tool_name)
            files["config.dat.diff"] = with_comments("config.dat.diff", difference, exported.comments).encode("latin-1")
        return files


class Ros(ExportFormat):
    name = "ros"
    summary = "the hand-eye transform for easy_handeye2 and TF, and the kinematics as ROS parameters"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        T, t = exported.T_flange_scanner, exported.targets
        hand_eye = ros.hand_eye_yaml(T, name=t.name, base=t.base_frame, flange=t.flange_frame, scanner=t.scanner_frame)
        return {
            f"{t.name}.calib": hand_eye,
            "scanner.launch.py": ros.launch_file(T, t.flange_frame, t.scanner_frame),
            "static_transform.sh": "#!/bin/sh\nexec " + ros.static_transform_command(T, t.flange_frame, t.scanner_frame) + "\n",
            "kinematics.yaml": joint_frames.kinematics_yaml(exported.chains[1], exported.robot_name),
        }


class Mjcf(ExportFormat):
    name = "mjcf"
    summary = "the arm as a MuJoCo model, with the effects that such a model can hold"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        lines, name = mjcf_comments(exported.result), exported.robot_name or "arm"
        return {"arm.mjcf.xml": mjcf.mjcf(exported.chains[1], exported.T_flange_scanner, name, lines, exported.effects)}


class Urdf(ExportFormat):
    name = "urdf"
    summary = "a calibrated copy of the URDF or xacro that is given by --urdf"

    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        t = exported.targets
        if t.urdf is None:
            return {}
        joints = t.joints or None
        where = {"T_flange_scanner": exported.T_flange_scanner, "scanner": t.scanner_frame}
        return {t.urdf.name: urdf.patch(t.urdf, *exported.chains, joints=joints, comments=exported.comments, **where)}
