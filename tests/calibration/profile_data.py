"""Simulated line profiles of one sphere, with the flange's pose of each, the truth and the noise that was put in."""

from dataclasses import dataclass

import numpy as np
from hand_eye_data import POSE_SIGMA, frame

from mbcacq.calibration.profile_start import find_start
from mbcacq.geometry import se3
from mbcacq.model.cell import ARTEFACT_IN_SCANNER
from mbcacq.recording.datasets.line_profiles import Sections, sphere_observations
from mbcacq.spheres.circles import circles_in

RADIUS = 15.0
POINT_SIGMA = 0.02
VIEW = np.radians(60.0)  # largest incidence that the scanner still measures


@dataclass(frozen=True)
class Profiles:
    """reported: poses of the flange (P, 4, 4). points: (n, 2) x and z of each profile. T_hand_eye: scanner on the flange, or in the base.
    sphere: (3,) in the frame in which it rests. in_scanner: (P, 3), where the sphere truly was."""

    reported: np.ndarray
    points: list
    T_hand_eye: np.ndarray
    sphere: np.ndarray
    in_scanner: np.ndarray


def profiles(rng, *, sweeps=12, steps=10, measurement=ARTEFACT_IN_SCANNER, noise=1.0, background=False) -> Profiles:
    """Sweeps across the sphere, each with an orientation of its own; what is beside the sphere lies 20 mm behind its centre."""
    X = frame(rng, 20.0, [30.0, -10, 120], 0.3)
    if measurement != ARTEFACT_IN_SCANNER:
        X = frame(rng, 50.0, [650.0, 0, 900], 0.3) @ se3.transform(np.diag([1.0, -1, -1]), np.zeros(3))
    sphere = np.array([650.0, 20, 90]) if measurement == ARTEFACT_IN_SCANNER else np.array([10.0, 20, 60])
    true, points, seen = [], [], []
    for _ in range(sweeps):
        down = np.diag([1.0, -1, -1]) if measurement == ARTEFACT_IN_SCANNER else np.diag([1.0, 1, 1])
        R = se3.rotation_exp(0.4 * rng.normal(size=3)) @ down
        x, z = rng.uniform(-20, 20), 300 + rng.uniform(-20, 20)
        for y in np.linspace(-0.8, 0.8, steps) * RADIUS:
            s = np.array([x, y, z])
            if measurement == ARTEFACT_IN_SCANNER:
                T = se3.transform(R, sphere - R @ (X[:3, :3] @ s + X[:3, 3]))
            else:
                T = se3.transform(R, X[:3, :3] @ s + X[:3, 3] - R @ sphere)
            true.append(T)
            points.append(_section(rng, s, noise, background))
            seen.append(s)
    true = np.array(true)
    off = noise * POSE_SIGMA * rng.normal(size=(len(true), 6))
    reported = se3.transform(se3.rotation_exp(off[:, 3:]) @ true[:, :3, :3], true[:, :3, 3] + off[:, :3])
    return Profiles(reported, points, X, sphere, np.array(seen))


def _section(rng, s, noise, background):
    r = np.sqrt(RADIUS**2 - s[1] ** 2)
    across = np.arange(-40, 40, 0.2)
    up = np.sqrt(np.maximum(RADIUS**2 - s[1] ** 2 - (across - s[0]) ** 2, 0.0))
    on = (np.abs(across - s[0]) < r) & (up > np.cos(VIEW) * RADIUS)
    out = np.column_stack([across[on], s[2] - up[on]])
    if background:
        beside = np.abs(across - s[0]) > RADIUS + 2
        out = np.concatenate([out, np.column_stack([across[beside], np.full(beside.sum(), s[2] + 20.0)])])
    return out + noise * POINT_SIGMA * rng.normal(size=out.shape)


def observed(shown, measurement):
    """The profiles as observations."""
    circles, noise = circles_in(shown.points, RADIUS)
    count = np.arange(len(circles))
    sections = Sections(count, count + 1, circles, noise, 0)
    hand = shown.reported if measurement == ARTEFACT_IN_SCANNER else se3.inverse(shown.reported)
    return sphere_observations(shown.reported, measurement, find_start(hand, circles, RADIUS), sections, RADIUS, "simulated")
