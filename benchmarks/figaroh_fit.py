"""An arm fitted by FIGAROH, in the environment that has it (with Pinocchio): FILE.npz in, one JSON object out.

    python -m venv peer && peer/bin/pip install figaroh
    peer/bin/python benchmarks/figaroh_fit.py FILE.npz

FILE.npz, written by ``benchmarks/solve.py``: q (P, n) rad and xyz (P, 3) mm of a reflector; placements (n + 1, 4, 4) mm, of each joint in
the frame behind the one before, all axes along z, and of the flange. The arm goes over as a URDF, the readings as the CSV of FIGAROH.
Fitted are what it finds identifiable of six parameters a joint, the place of the base and of the reflector, from its own first guess.
"""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pinocchio
import yaml
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.robot import Robot

METHODS, REPEATS = ("structural", "map"), 5  # its default, and a prior for every parameter instead of a selection
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


class ArmCalibration(BaseCalibration):
    """FIGAROH's calibration with a cost function of one's own, as its manual asks for. With positions alone the residual is a
    difference; the function of its examples makes the logarithm of a pose of each reading, which gives the same and takes longer."""

    def cost_function(self, var: np.ndarray) -> np.ndarray:
        return 1e3 * (calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config) - self.PEE_measured)


def urdf(placements: np.ndarray) -> str:
    """An arm of revolute joints j1..jn about z and a fixed link 'flange'; placements (n + 1, 4, 4) mm."""
    n = len(placements) - 1
    links = [f"l{i}" for i in range(n + 1)] + ["flange"]
    lines = ['<robot name="arm">', *(f'<link name="{name}">{INERTIAL}</link>' for name in links)]
    for i, T in enumerate(placements):
        kind, name = ("fixed", "mount") if i == n else ("revolute", f"j{i + 1}")
        xyz = " ".join(f"{v:.15g}" for v in T[:3, 3] / 1e3)
        rpy = " ".join(f"{v:.15g}" for v in pinocchio.rpy.matrixToRpy(T[:3, :3]))
        lines.append(f'<joint name="{name}" type="{kind}"><parent link="{links[i]}"/><child link="{links[i + 1]}"/>')
        lines.append(f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>')
        lines.append('<limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>')
    return "\n".join([*lines, "</robot>"])


def configuration(table: Path, method: str) -> dict:
    """The task in FIGAROH's format: one reflector, of which the position is measured. method: which parameters it estimates, and how."""
    marker = {"name": "reflector", "measurable_dof": [True] * 3 + [False] * 3}
    return {
        "robot": {"name": "arm"},
        "tasks": {
            "calibration": {
                "type": "kinematic_calibration",
                "kinematics": {"base_frame": "universe", "tool_frame": "flange"},
                "parameters": {"calibration_level": "full_params", "outlier_threshold": 0.02, "estimation": {"method": method}},
                "measurements": {"markers": [marker], "poses": {"base_pose": [0.0] * 6, "tool_pose": [0.0] * 6}},
                "data": {"source_file": str(table), "validation_data_file": "", "number_of_samples": 1},
            }
        },
    }


def fitted(description: Path, config: Path) -> dict:
    """One fit from nothing: processor time, 3D rms of the readings, evaluations of which each has its numerical derivatives, parameters."""
    calibration = ArmCalibration(Robot(str(description), package_dirs=""), str(config))
    calibration.calib_config["known_baseframe"] = calibration.calib_config["known_tipframe"] = False
    begin = time.process_time()
    calibration.initialize()
    result, _ = calibration.solve_optimisation()
    seconds = time.process_time() - begin
    residual = (calibration.get_pose_from_measure(result.x) - calibration.PEE_measured).reshape(3, -1)
    rms = 1e3 * float(np.sqrt(np.mean(np.sum(residual**2, axis=0))))
    return {"seconds": seconds, "rms_mm": rms, "evaluations": int(result.nfev), "parameters": len(result.x)}


def main() -> None:
    given, found = np.load(sys.argv[1]), {}
    with tempfile.TemporaryDirectory() as folder:
        table, description, config = (Path(folder) / name for name in ("readings.csv", "arm.urdf", "arm.yaml"))
        header = ",".join(["x1", "y1", "z1", *(f"j{i + 1}" for i in range(given["q"].shape[1]))])
        np.savetxt(table, np.column_stack([given["xyz"] / 1e3, given["q"]]), fmt="%.17g", delimiter=",", header=header, comments="")
        description.write_text(urdf(given["placements"]))
        for method in METHODS:
            config.write_text(yaml.safe_dump(configuration(table, method)))
            with contextlib.redirect_stdout(sys.stderr):
                found[method] = min((fitted(description, config) for _ in range(REPEATS)), key=lambda one: one["seconds"])
    print(json.dumps(found))


if __name__ == "__main__":
    main()
