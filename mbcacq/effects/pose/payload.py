"""A tool that is heavier than declared, or has its centre of gravity elsewhere; it shows only through the compliance of the joints.

The wind-up c_i tau_i of each elastic joint contains the tool's weight. With the compliances c_i of the model so far, an error of the mass
and of the first moment of mass (mass times centre of gravity, flange frame) is linear: four coefficients.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Coupling, Declaration, Where
from mbcacq.effects.effect import Candidate, Missing, number, vector
from mbcacq.effects.functions import ZERO, Column, DescribedPart, linear, scaled

NAME = "payload"
THROUGH = "joint_compliance"
LOADS = ("mass", "x", "y", "z")  # of the covariates ``payload_torque_I_LOAD``: a kilogram, and kilogram millimetres along each flange axis
LEAST_LOAD_SHARE = 0.15  # of the largest range of gravity torque


def candidates(context: Context) -> list[Candidate]:
    """No candidate: compliance has to be found first, then ``correction_for`` gives one."""
    if not context.masses_known:
        raise Missing("no masses of the links and the tool given")
    return []


def loaded_joints(context: Context) -> list[int]:
    """Joints whose gravity torque varies enough for their compliance to matter."""
    load = np.ptp(context.gravity_torque, axis=0)
    return [i for i in range(context.n) if load[i] > LEAST_LOAD_SHARE * load.max()]


def loaded_locations(context: Context) -> list[Where]:
    """The same as locations."""
    return [(f"A{i + 1}",) for i in loaded_joints(context)]


def under_load(context: Context, compliance: Candidate, coefficients: np.ndarray, number: str) -> Candidate:
    """An elastic joint under the torque of the declared tool and of an error (4,) of it."""
    (at,) = compliance.where
    column: Column = linear(f"gravity_torque_{at[1:]}")
    for load, size in zip(LOADS, coefficients, strict=True):
        column += scaled(linear(f"payload_torque_{at[1:]}_{load}"), float(size))
    variant = f"heavy {number} {','.join(f'{c:.9g}' for c in coefficients)}"
    return replace(compliance, described=[DescribedPart("joint", int(at[1:]) - 1, 0, (column,))], variant=variant)


def correction_for(
    context: Context, compliances: Mapping[Where, float], spread: np.ndarray | None = None, complete: bool = False
) -> list[Candidate]:
    """The candidate for an error of the declared tool, given the compliance of joints: location -> rad/(N m).

    spread: covariance (4, 4) of mass and first moments, where it is known with the uncertainty of the compliances in it. complete:
    every elastic joint is among those given. Otherwise each other loaded joint gets a free compliance: it is as soft as any, though
    perhaps too little loaded to be found by itself, and the mass would take its part.
    """
    compliance = {int(at[1:]) - 1: value for (at,), value in compliances.items()}
    if not context.masses_known or not compliance or not context.scanner_on_flange:
        return []
    elastic, softest = dict(compliance), max(compliance.values())
    beyond = [] if complete else [i for i in loaded_joints(context) if i not in elastic]
    parts = []
    for i, c in sorted({**elastic, **dict.fromkeys(beyond, softest)}.items()):
        own = [linear(f"gravity_torque_{i + 1}") if i == j else ZERO for j in beyond]
        load = [linear(f"payload_torque_{i + 1}_{what}", float(c)) for what in LOADS]
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
    return [Candidate(NAME, where, cause, parts, report, typical, variant=label)]


DECLARED = Declaration(
    coupling=Coupling(
        name=NAME,
        through=THROUGH,
        size=len(LOADS),
        parameter="compliance_rad_per_Nm",
        locations=loaded_locations,
        candidates=correction_for,
        carrier=under_load,
        advice="a payload other than declared explains as much as elastic joints ({odds}): weigh the tool",
    ),
    # A tool cannot be any weight, and shows only on a soft arm.
    challenge=Challenge(number=21, companions=(THROUGH,), strongest=1.5, options={"compliance_rad_per_Nm": 6e-6}),
)
