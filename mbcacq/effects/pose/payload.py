"""A tool that is heavier than declared, or has its centre of gravity elsewhere; it shows only through the compliance of the joints.

The wind-up c_i tau_i of each elastic joint contains the tool's weight. With the compliances c_i of the model so far, an error of the mass
and of the first moment of mass (mass times centre of gravity, flange frame) is linear: four coefficients.
"""

from collections.abc import Mapping

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.described import built
from mbcacq.effects.effect import Candidate, Missing, number, vector
from mbcacq.effects.functions import ZERO, DescribedPart, linear

NAME = "payload"
LEAST_LOAD_SHARE = 0.15  # of the largest range of gravity torque


def candidates(context: Context) -> list[Candidate]:
    """No candidate: compliance has to be found first, then ``correction_for`` gives one."""
    if not context.masses_known:
        raise Missing("no masses of the links and the tool given")
    return []


def unit_torques(context: Context) -> np.ndarray:
    """Torque (P, n, 4) N m about each joint by a kilogram at the flange's origin, and by a kilogram millimetre along each flange axis."""
    return context.payload_torque


def loaded_joints(context: Context) -> list[int]:
    """Joints whose gravity torque varies enough for their compliance to matter."""
    load = np.ptp(context.gravity_torque, axis=0)
    return [i for i in range(context.n) if load[i] > LEAST_LOAD_SHARE * load.max()]


def correction_for(
    context: Context, compliance: Mapping[int, float], spread: np.ndarray | None = None, complete: bool = False
) -> list[Candidate]:
    """The candidate for an error of the declared tool, given the compliance of joints: index -> rad/(N m).

    spread: covariance (4, 4) of mass and first moments, where it is known with the uncertainty of the compliances in it. complete:
    every elastic joint is among those given. Otherwise each other loaded joint gets a free compliance: it is as soft as any, though
    perhaps too little loaded to be found by itself, and the mass would take its part.
    """
    if not context.masses_known or not compliance or not context.scanner_on_flange:
        return []
    elastic, softest = dict(compliance), max(compliance.values())
    beyond = [] if complete else [i for i in loaded_joints(context) if i not in elastic]
    parts = []
    for i, c in sorted({**elastic, **dict.fromkeys(beyond, softest)}.items()):
        own = [linear(f"gravity_torque_{i + 1}") if i == j else ZERO for j in beyond]
        load = [linear(f"payload_torque_{i + 1}_{what}", float(c)) for what in ("mass", "x", "y", "z")]
        parts.append(DescribedPart("joint", i, 0, (*load, *own)))
    mass, com = float(np.mean(context.payload_mass)), context.obs.cell.robot.payload_com

    def report(c, v, _):
        new_mass = max(mass + c[0], 0.05)
        new_com = (mass * com + c[1:4]) / new_mass
        slope = np.concatenate([-new_com[:, None], np.eye(3)], axis=1) / new_mass
        v_payload = v[:4, :4] if spread is None else spread
        out = {"mass_kg": number(new_mass, np.sqrt(v_payload[0, 0])), "com_mm": vector(new_com, slope @ v_payload @ slope.T)}
        for k, i in enumerate(beyond, start=4):
            out[f"A{i + 1}.compliance_rad_per_Nm"] = number(c[k], np.sqrt(v[k, k]))
        return out

    label = ",".join(f"{i}:{c:.3e}" for i, c in sorted(compliance.items()))
    typical = np.array([0.5, 50.0, 50.0, 50.0] + [1.5e-6] * len(beyond))
    where, cause = ("mount",), "gravity_torque_2"
    return [Candidate(NAME, where, cause, built(context, parts), report, typical, variant=label, described=lambda _: parts)]
