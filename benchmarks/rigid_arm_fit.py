"""An independent fit of the KR 300's torque, to compare the diagnosis with: nothing of mbcacq is used.

    python benchmarks/rigid_arm_fit.py ../shared/data/kr300-trajectory-a ../shared/data/kr300-trajectory-b

The masses are those of cell.yaml and stay fixed; a point mass hangs 100 mm in front of the flange; the gas balancer of A2 is off, as the
source of the data publishes it (isothermal gas, two anchor points), or that with a free factor. Per joint an offset, Coulomb and viscous
friction and the rotor are fitted by least squares on one trajectory and tested on the other.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import yaml
from scipy.signal import savgol_filter

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


def main() -> None:
    links = yaml.safe_load((Path(sys.argv[1]) / "cell.yaml").read_text())["robot"]["links"]
    runs = []
    for folder in map(Path, sys.argv[1:3]):
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
    main()
