"""Torque lost in the drive train: Coulomb and viscous friction, growing with load, and the Stribeck bump at low speed."""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, sense

NAME = "friction"
TERMS = ("coulomb_Nm", "viscous_Nms_per_rad")
LEAST_LOAD = 0.05  # change of the load, as a share of the torque's, without which no dependence on it can be seen


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "tau":
        return []
    depends, axis = f"qd{channel.joint + 1}", channel.axis
    fastest = max(float(np.abs(run.qd[:, channel.joint]).max()) for run in runs)
    out = [Candidate(NAME, (axis,), depends, _plain, lambda c, v, _: _named(axis, TERMS, c, v), positive=True)]
    stribeck = np.geomspace(0.01, 0.3, 8) * max(fastest, 1e-6)
    out.append(Candidate(
        NAME, (axis,), depends, _stribeck, hyper=stribeck, positive=True, search=3.0,
        report=lambda c, v, s: _named(axis, (*TERMS, "stribeck_Nm"), c, v)
        | {f"{axis}.stribeck_speed_rad_per_s": {"value": float(s), "std": 0.0}},
    ))
    if all(np.ptp(np.abs(run.gravity[:, channel.joint])) > LEAST_LOAD * np.ptp(run.torque[:, channel.joint]) for run in runs):
        out.append(Candidate(NAME, (axis,), depends, _load, positive=True,
                             report=lambda c, v, _: _named(axis, (*TERMS, "load_dependent"), c, v)))
    return out


def _plain(run: Run, joint: int, _: float | None) -> np.ndarray:
    return np.stack([sense(run, joint), run.qd[:, joint]], axis=1)


def _stribeck(run: Run, joint: int, speed: float | None) -> np.ndarray:
    bump = sense(run, joint) * np.exp(-((run.qd[:, joint] / speed) ** 2))
    return np.column_stack([_plain(run, joint, None), bump])


def _load(run: Run, joint: int, _: float | None) -> np.ndarray:
    return np.column_stack([_plain(run, joint, None), sense(run, joint) * np.abs(run.gravity[:, joint])])


def _named(axis: str, names: tuple[str, ...], c: np.ndarray, v: np.ndarray) -> dict:
    return {f"{axis}.{name}": {"value": float(c[k]), "std": float(np.sqrt(v[k, k]))} for k, name in enumerate(names)}
