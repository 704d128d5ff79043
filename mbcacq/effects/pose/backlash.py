"""Lost motion: a joint's angle is off by half the width of its backlash, with the sense of its last motion or of the gravity torque."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Hyperparameter, Missing, Part, number

NAME = "backlash"
FEWEST, LEAST = 4, 0.005  # poses, and share of them, that the torque must push the other way
TRANSITIONS = np.array([0.0, 0.03, 0.1, 0.3, 1.0])  # N m over which the teeth change sides: tanh(torque / transition); 0: at once


def candidates(s: Context) -> list[Candidate]:
    out = []
    if s.obs.direction is not None:
        out += [make(i, f"direction_{i + 1}", s.obs.direction[:, i].astype(float)) for i in range(s.n) if np.ptp(s.obs.direction[:, i]) > 0]
    if s.masses_known:
        torque = s.gravity_torque
        fewest = max(FEWEST, LEAST * s.obs.n_poses)
        changes = [i for i in range(s.n) if min(np.sum(torque[:, i] > 0), np.sum(torque[:, i] < 0)) >= fewest]
        out += [under_load(i, torque[:, i]) for i in changes if np.ptp(torque[:, i]) > 0.5]
    if s.obs.direction is None and not out:
        raise Missing("no senses of motion recorded (dir1..)")
    return out


def make(i: int, depends_on: str, sense: np.ndarray) -> Candidate:
    return Candidate(NAME, (f"A{i + 1}",), depends_on, lambda _: [Part("joint", i, 0, sense[:, None])], report_of(i), np.array([3e-5]))


def under_load(i: int, torque: np.ndarray) -> Candidate:
    """Sense of the gravity torque (P,) N m; wider transitions than a twentieth of its range would be elasticity."""
    values = TRANSITIONS[TRANSITIONS < 0.05 * np.ptp(torque)]

    def build(transition):
        sense = np.tanh(torque / transition) if transition else np.sign(torque)
        return [Part("joint", i, 0, sense[:, None])]

    hyper = Hyperparameter("transition_Nm", values, 2.0, refine=False, preferred=(0.0,))
    return Candidate(NAME, (f"A{i + 1}",), f"gravity_torque_{i + 1}", build, report_of(i), np.array([3e-5]), hyper)


def report_of(i: int):
    def report(c, v, _):
        return {f"A{i + 1}.width_deg": number(np.degrees(2 * abs(c[0])), np.degrees(2 * np.sqrt(v[0, 0])))}

    return report
