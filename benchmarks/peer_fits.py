"""Fits by others, to compare with: pybotics and FIGAROH in environments of their own, and a rigid arm that knows its load.

    peer/bin/python benchmarks/peer_fits.py pybotics FILE.npz
    other/bin/python benchmarks/peer_fits.py figaroh FILE.npz
    python benchmarks/peer_fits.py kr300 ../shared/data/kr300-trajectory-a ../shared/data/kr300-trajectory-b

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
import time
from pathlib import Path

import bench
import numpy as np
import yaml
from bench import option

MOST_EVALUATIONS = 20


def pybotics(given: argparse.Namespace) -> None:
    """An arm fitted by pybotics, in the environment that has it (it needs an older numpy): FILE.npz in, one JSON object out.

        python -m venv peer && peer/bin/pip install pybotics

    FILE.npz, written by ``benchmarks/speed.py``: q (P, n) rad and xyz (P, 3) mm of a reflector; links (n, 4) alpha, a, theta, d of
    the modified DH convention; free (n, 4) bool; tool (6,) and world (6,), first guesses: x, y, z mm and the angles of pybotics.
    Fitted are the free parameters of the links, the position of the tool and the whole place of the base.
    """
    from pybotics.geometry import vector_2_matrix
    from pybotics.kinematic_chain import MDHKinematicChain
    from pybotics.optimization import OptimizationHandler, optimize_accuracy
    from pybotics.robot import Robot
    from pybotics.tool import Tool
    from scipy.optimize import least_squares

    asked = np.load(given.file)
    robot = Robot(MDHKinematicChain.from_parameters(asked["links"].ravel()), Tool(vector_2_matrix(asked["tool"])))
    robot.world_frame = vector_2_matrix(asked["world"])
    handler = OptimizationHandler(
        robot, kinematic_chain_mask=asked["free"].ravel().tolist(), tool_mask=[True] * 3 + [False] * 3, world_mask=[True] * 6
    )
    begin = time.process_time()
    data = handler, asked["q"], asked["xyz"]
    start = handler.generate_optimization_vector()
    found = least_squares(optimize_accuracy, start, args=data, x_scale="jac", max_nfev=MOST_EVALUATIONS)
    seconds = time.process_time() - begin
    print(json.dumps({"seconds": seconds, "rms_mm": float(np.sqrt(2 * found.cost / len(asked["q"]))), "evaluations": int(found.nfev)}))


METHODS, REPEATS = ("structural", "map"), 5  # its default, and a prior for every parameter instead of a selection
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


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


def arm_calibration() -> type:
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm

    class ArmCalibration(BaseCalibration):
        """FIGAROH's calibration with a cost function of one's own, as its manual asks for. With positions alone the residual is a
        difference; the function of its examples makes the logarithm of a pose of each reading, which gives the same and takes longer."""

        def cost_function(self, var: np.ndarray) -> np.ndarray:
            return 1e3 * (calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config) - self.PEE_measured)

    return ArmCalibration


def urdf(placements: np.ndarray) -> str:
    """An arm of revolute joints j1..jn about z and a fixed link 'flange'; placements (n + 1, 4, 4) mm."""
    import pinocchio

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


def fitted(description: Path, config: Path) -> dict:
    """One fit from nothing: processor time, 3D rms of the readings, evaluations of which each has its numerical derivatives, parameters."""
    from figaroh.tools.robot import Robot

    calibration = arm_calibration()(Robot(str(description), package_dirs=""), str(config))
    calibration.calib_config["known_baseframe"] = calibration.calib_config["known_tipframe"] = False
    begin = time.process_time()
    calibration.initialize()
    result, _ = calibration.solve_optimisation()
    seconds = time.process_time() - begin
    residual = (calibration.get_pose_from_measure(result.x) - calibration.PEE_measured).reshape(3, -1)
    rms = 1e3 * float(np.sqrt(np.mean(np.sum(residual**2, axis=0))))
    return {"seconds": seconds, "rms_mm": rms, "evaluations": int(result.nfev), "parameters": len(result.x)}


def figaroh(given: argparse.Namespace) -> None:
    """An arm fitted by FIGAROH, in the environment that has it (with Pinocchio): FILE.npz in, one JSON object out.

        python -m venv peer && peer/bin/pip install figaroh

    FILE.npz, written by ``benchmarks/speed.py``: q (P, n) rad and xyz (P, 3) mm of a reflector; placements (n + 1, 4, 4) mm, of each
    joint in the frame behind the one before, all axes along z, and of the flange. The arm goes over as a URDF, the readings as the
    CSV of FIGAROH. Fitted are what it finds identifiable of six parameters a joint, the place of the base and of the reflector, from
    its own first guess.
    """
    asked, found = np.load(given.file), {}
    with tempfile.TemporaryDirectory() as folder:
        table, description, config = (Path(folder) / name for name in ("readings.csv", "arm.urdf", "arm.yaml"))
        header = ",".join(["x1", "y1", "z1", *(f"j{i + 1}" for i in range(asked["q"].shape[1]))])
        np.savetxt(table, np.column_stack([asked["xyz"] / 1e3, asked["q"]]), fmt="%.17g", delimiter=",", header=header, comments="")
        description.write_text(urdf(asked["placements"]))
        for method in METHODS:
            config.write_text(yaml.safe_dump(configuration(table, method)))
            with contextlib.redirect_stdout(sys.stderr):
                found[method] = min((fitted(description, config) for _ in range(REPEATS)), key=lambda one: one["seconds"])
    print(json.dumps(found))


GRAVITY, WINDOW, STEP_S = 9.81, 23, 0.004
PAYLOADS_KG = (0, 100, 150, 200)


def torque(links, q, qd, qdd, mass, com):
    """(T, 6) N m by recursive Newton-Euler; com (6, 3) m in the frame of each link, no inertia about it."""
    z, w, dw, a = np.array([0, 0, 1.0]), np.zeros((len(q), 3)), np.zeros((len(q), 3)), np.tile([0, 0, GRAVITY], (len(q), 1))
    rotations, levers, forces, moments = [], [], [], []
    for j, row in enumerate(links):
        angle, alpha = row["sign"] * q[:, j] + np.radians(row["theta_deg"]), np.radians(row["alpha_deg"])
        c, s, ca, sa, zero = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha), np.zeros(len(q))
        R = np.moveaxis(np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [zero, zero + sa, zero + ca]]), -1, 0)
        lever = 1e-3 * np.stack([row["a_mm"] * c, row["a_mm"] * s, zero + row["d_mm"]], axis=1)
        turn = row["sign"] * qd[:, [j]] * z
        dw, w = dw + row["sign"] * qdd[:, [j]] * z + np.cross(w, turn), w + turn
        a = a + np.cross(dw, lever) + np.cross(w, np.cross(w, lever))
        w, dw, a = (np.einsum("tji,tj->ti", R, v) for v in (w, dw, a))
        force = mass[j] * (a + np.cross(dw, com[j]) + np.cross(w, np.cross(w, com[j])))
        forces.append(force), moments.append(np.cross(com[j], force)), rotations.append(R), levers.append(lever)
    out, force, moment = np.empty(q.shape), np.zeros((len(q), 3)), np.zeros((len(q), 3))
    for j in reversed(range(len(links))):
        force, moment = (np.einsum("tij,tj->ti", rotations[j], v) for v in (force + forces[j], moment + moments[j]))
        moment = moment + np.cross(levers[j], force)
        out[:, j] = links[j]["sign"] * moment[:, 2]
    return out


def balancer(q2):
    """Torque (T,) N m of the gas balancer: anchors 0.8 m and 0.2 m from the axis, least force at -95 deg, 0.159 kg of nitrogen at 328 K."""
    delta, far, near = q2 + np.radians(95), 0.8, 0.2
    length, area = np.sqrt(far**2 + near**2 - 2 * far * near * np.cos(delta)), np.pi / 4 * (0.055**2 - 0.030**2)
    pressure = 1.01 * 296.8 * 328 * 0.159 / (0.00096 - (length - far + near) * area)
    return np.sin(delta) * far * near / length * pressure * area


def columns(rates, motor, links, payload, law, j):
    """Columns and mismatch of one joint, where it moves."""
    q, qd, qdd = rates
    mass, com = np.array([row["mass_kg"] for row in links]), 1e-3 * np.array([row["com_mm"] for row in links], float)
    com[5] = (mass[5] * com[5] + payload * np.array([0, 0, 0.1])) / (mass[5] + payload)
    mass[5] += payload
    y = (motor * [row["gear_ratio"] for row in links] - torque(links, q, qd, qdd, mass, com))[:, j]
    z = [np.ones(len(q)), np.tanh(qd[:, j] / 0.01), qd[:, j], qdd[:, j]]
    if j == 1:
        y = y - balancer(q[:, 1]) * (law == "drawing")
        z += [balancer(q[:, 1])] * (law == "scaled")
    use = np.abs(qd[:, j]) > 0.02 * np.abs(qd[:, j]).max()
    use[:12] = use[-12:] = False
    return np.stack(z, axis=1)[use], y[use]


def kr300(given: argparse.Namespace) -> None:
    """An independent fit of the KR 300's torque, to compare the diagnosis with: nothing of mbcacq is used.

    The masses are those of cell.yaml and stay fixed. A point mass hangs 100 mm in front of the flange. The gas balancer of A2 is off, as
    the source of the data publishes it (isothermal gas, two anchor points), or that with a free factor. Per joint an offset, Coulomb and
    viscous friction and the rotor are fitted by least squares on one trajectory and tested on the other.
    """
    from scipy.signal import savgol_filter

    links = yaml.safe_load((given.folders[0] / "cell.yaml").read_text())["robot"]["links"]
    runs = []
    for folder in given.folders:
        table = np.genfromtxt(folder / "trajectory.csv", delimiter=",", names=True)
        q = np.radians(np.stack([table[f"q{j}_deg"] for j in range(1, 7)], axis=1))
        rates = [np.asarray(savgol_filter(q, WINDOW, 5, deriv=d, delta=STEP_S, axis=0)) for d in range(3)]
        runs.append((rates, np.stack([table[f"motor_tau{j}_Nm"] for j in range(1, 7)], axis=1)))
    print("| payload, kg | balancer | tested on | " + " | ".join(f"A{j}" for j in range(1, 7)) + " |\n|--:|---|---|" + "--:|" * 6)
    for payload in PAYLOADS_KG:
        for law in ("none", "drawing", "scaled"):
            for test, name in enumerate("ab"):
                rms = []
                for j in range(6):
                    A, y = columns(*runs[1 - test], links, payload, law, j)
                    B, target = columns(*runs[test], links, payload, law, j)
                    rms.append(float(np.sqrt(np.mean((target - B @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))))
                print(f"| {payload} | {law} | {name} | " + " | ".join(f"{r:.0f}" for r in rms) + " |")


if __name__ == "__main__":
    FILE = option("file", type=Path, metavar="FILE.npz")
    bench.main(
        __doc__,
        {
            "pybotics": (pybotics, [FILE]),
            "figaroh": (figaroh, [FILE]),
            "kr300": (kr300, [option("folders", type=Path, nargs=2, metavar="FOLDER")]),
        },
    )
