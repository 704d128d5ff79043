"""Lost motion: a joint's angle is off by half the width of its backlash, with the sense of its last motion or of the gravity torque."""

import numpy as np

from mbcacq.physics.effect import Candidate, Missing, Part, number
from mbcacq.physics.situation import Situation

NAME = "backlash"


def candidates(s: Situation) -> list[Candidate]:
    out = []
    if s.obs.direction is not None:
        out += [make(i, f"direction_{i + 1}", s.obs.direction[:, i].astype(float)) for i in range(s.n) if np.ptp(s.obs.direction[:, i]) > 0]
    if s.masses_known:
        torque = s.gravity_torque
        changes = [i for i in range(s.n) if min(np.mean(torque[:, i] > 0), np.mean(torque[:, i] < 0)) > 0.04]
        out += [make(i, f"gravity_torque_{i + 1}", np.sign(torque[:, i])) for i in changes if np.ptp(torque[:, i]) > 0.5]
    if s.obs.direction is None and not out:
        raise Missing("no senses of motion recorded (dir1..)")
    return out


def make(i: int, depends_on: str, sense: np.ndarray) -> Candidate:
    def report(c, v, _):
        return {f"A{i + 1}.width_deg": number(np.degrees(2 * abs(c[0])), np.degrees(2 * np.sqrt(v[0, 0])))}

    return Candidate(NAME, (f"A{i + 1}",), depends_on, lambda _: [Part("joint", i, 0, sense[:, None])], report, np.array([3e-5]))
