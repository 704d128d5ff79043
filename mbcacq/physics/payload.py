"""A tool heavier, or hung elsewhere, than declared: seen through the elasticity of the joints, so only together with it.

The wind-up c_i tau_i of each elastic joint contains the tool's weight. With c_i from the model so far, an error of the mass and of
the first moment of mass (mass times centre of gravity, flange frame) is linear: four coefficients.
"""

from collections.abc import Mapping

import numpy as np

from mbcacq.geometry import gravity
from mbcacq.physics.effect import Candidate, Missing, Part, number, vector
from mbcacq.physics.situation import Situation

NAME = "payload"


def candidates(s: Situation) -> list[Candidate]:
    """None by itself: elasticity has to be found first, then ``beside`` applies."""
    if not s.masses_known:
        raise Missing("no masses of the links and the tool given")
    return []


def unit_torques(s: Situation) -> np.ndarray:
    """(P, n, 4) N m: by a kilogram at the flange's origin, and by a kilogram millimetre along each flange axis."""
    robot = s.obs.cell.robot
    frames = robot.chain.frames(s.obs.q)
    none = np.zeros(s.n)

    def torque(com: np.ndarray) -> np.ndarray:
        return gravity.gravity_torque(robot.chain, frames, none, np.zeros((s.n, 3)), 1.0, com, robot.gravity)

    at_origin = torque(np.zeros(3))
    return np.stack([at_origin] + [torque(e) - at_origin for e in np.eye(3)], axis=2)


def beside(s: Situation, compliance: Mapping[int, float]) -> list[Candidate]:
    """The candidate that goes with joints of known compliance: index -> rad/Nm."""
    if not s.masses_known or not compliance or not s.scanner_on_flange:
        return []
    torque = unit_torques(s)
    parts = [Part("joint", i, 0, c * torque[:, i]) for i, c in sorted(compliance.items())]
    mass, com = float(np.mean(s.payload_mass)), s.obs.cell.robot.payload_com

    def report(c, v, _):
        new_mass = max(mass + c[0], 0.05)
        new_com = (mass * com + c[1:]) / new_mass
        slope = np.concatenate([-new_com[:, None], np.eye(3)], axis=1) / new_mass
        return {"mass_kg": number(new_mass, np.sqrt(v[0, 0])), "com_mm": vector(new_com, slope @ v @ slope.T)}

    label = ",".join(f"{i}:{c:.1e}" for i, c in sorted(compliance.items()))
    return [Candidate(NAME, ("mount",), "gravity_torque_2", lambda _: parts, report, np.array([0.5, 50.0, 50.0, 50.0]), variant=label)]
