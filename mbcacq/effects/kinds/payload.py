"""A tool that is heavier than declared, or has its centre of gravity elsewhere.

At standstill it shows only through the compliance of the joints: the wind-up c_i tau_i of each elastic joint contains the tool's weight.
With the compliances c_i of the model so far, an error of the mass and of the first moment of mass (mass times centre of gravity, flange
frame) is linear: four coefficients. In motion it acts in the torque of all joints, by its ten inertial parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration, EffectCoupling, Where
from mbcacq.effects.effect import Candidate, Missing, Parameters, StandstillRows, number, vector
from mbcacq.effects.functions import ZERO, Column, DescribedPart, linear, scaled
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals, available
from mbcacq.geometry.dynamics import tool_sigma

NAME = "payload"
THROUGH = "joint_compliance"
LOADS = ("mass", "x", "y", "z")  # of the covariates ``payload_torque_I_LOAD``: a kilogram, and kilogram millimetres along each flange axis
LEAST_LOAD_SHARE = 0.15  # of the largest range of gravity torque
LEAST_MASS_KG = 0.05  # by which a first moment is divided, to state a centre of gravity


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
    return [(context.axes[i],) for i in loaded_joints(context)]


def under_load(context: Context, compliance: Candidate, coefficients: np.ndarray, number: str) -> Candidate:
    """An elastic joint under the torque of the declared tool and of an error (4,) of it."""
    (at,) = compliance.where
    joint, tag = context.axes.index(at), at.removeprefix("A")
    column: Column = linear(f"gravity_torque_{tag}")
    for load, size in zip(LOADS, coefficients, strict=True):
        column += scaled(linear(f"payload_torque_{tag}_{load}"), float(size))
    variant = f"heavy {number} {','.join(f'{c:.9g}' for c in coefficients)}"
    rows = replace(compliance.rows, described=[DescribedPart("joint", joint, 0, (column,))])
    return replace(compliance, rows=rows, variant=variant)


def tool(mass: float, com: np.ndarray, c: np.ndarray, v: np.ndarray) -> Parameters:
    """Mass (kg) and centre of gravity (3,) mm of a tool declared with these, and an error c (4,) kg, kg mm of covariance v (4, 4)."""
    new_mass = max(mass + c[0], LEAST_MASS_KG)
    new_com = (mass * com + c[1:4]) / new_mass
    slope = np.concatenate([-new_com[:, None], np.eye(3)], axis=1) / new_mass
    return {"mass_kg": number(mass + c[0], np.sqrt(max(v[0, 0], 0.0))), "com_mm": vector(new_com, slope @ v @ slope.T)}


def correction_for(
    context: Context, compliances: Mapping[Where, float], spread: np.ndarray | None = None, complete: bool = False
) -> list[Candidate]:
    """The candidate for an error of the declared tool, given the compliance of joints: location -> rad/(N m).

    spread: covariance (4, 4) of mass and first moments, where it is known with the uncertainty of the compliances in it. complete:
    every elastic joint is among those given. Otherwise each other loaded joint gets a free compliance: it is as soft as any, though
    perhaps too little loaded to be found by itself, and the mass would take its part.
    """
    compliance = {context.axes.index(at): value for (at,), value in compliances.items()}
    if not context.masses_known or not compliance or not context.scanner_on_flange:
        return []
    elastic, softest = dict(compliance), max(compliance.values())
    beyond = [] if complete else [i for i in loaded_joints(context) if i not in elastic]
    parts = []
    for i, c in sorted({**elastic, **dict.fromkeys(beyond, softest)}.items()):
        own = [linear(f"gravity_torque_{context.tags[i]}") if i == j else ZERO for j in beyond]
        load = [linear(f"payload_torque_{context.tags[i]}_{what}", float(c)) for what in LOADS]
        parts.append(DescribedPart("joint", i, 0, (*load, *own)))
    mass, com = float(np.mean(context.payload_mass)), context.obs.cell.robot.payload_com

    def report(c, v, _):
        out = dict(tool(mass, com, c[:4], v[:4, :4] if spread is None else spread))
        for k, i in enumerate(beyond, start=4):
            out[f"{context.axes[i]}.compliance_rad_per_Nm"] = number(c[k], np.sqrt(v[k, k]))
        return out

    label = ",".join(f"{i}:{c:.3e}" for i, c in sorted(compliance.items()))
    typical = np.array([0.5, 50.0, 50.0, 50.0] + [1.5e-6] * len(beyond))
    where, cause = ("mount",), "gravity_torque_2"
    return [Candidate(NAME, where, cause, StandstillRows(parts, typical), report, variant=label)]


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "tau" or any(run.payload is None for run in runs):
        return []
    robot = runs[0].robot
    assert robot is not None, "torques by unit inertial parameters are of an arm"
    load = (("mass_kg", 1.0), *((f"moment_{axis}_kg_mm", 1e3) for axis in "xyz"))
    sigma = tuple(tool_sigma(robot))
    rows = MotionRows(group.joints, lambda run, j, _: available(run.payload)[:, j], sigma, usual=True, tested=4, load_parameters=load)
    mass, com, to_mm = float(robot.payload_mass), np.asarray(robot.payload_com, dtype=float), np.array([1.0, 1e3, 1e3, 1e3])

    def report(c, v, _):
        """The whole tool in the words of the poses; what there is in kg mm is in kg m here."""
        return tool(mass, com, to_mm * c[:4], v[:4, :4] * np.outer(to_mm, to_mm))

    return [Candidate(NAME, ("mount",), "gravity_torque", rows, report)]


DECLARED = Declaration(
    coupling=EffectCoupling(
        name=NAME,
        through=THROUGH,
        size=len(LOADS),
        parameter="compliance_rad_per_Nm",
        locations=loaded_locations,
        candidates=correction_for,
        carrier=under_load,
        advice="a payload other than declared explains as much as elastic joints ({odds}): weigh the tool",
    ),
    adds_body=True,
    model_block="inertia",
    # A tool cannot be any weight, and shows only on a soft arm.
    challenge=Challenge(number=21, in_motion=10, companions=(THROUGH,), strongest=1.5, options={"compliance_rad_per_Nm": 6e-6}),
)
