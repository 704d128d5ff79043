"""The calibrated arm for MuJoCo: bodies with hinges, and the effects that springs, masses and constraints between hinges can express.

A compliance is a second hinge about the joint's axis, held by a spring, so that weight winds it up; a pedestal that tilts stands on three
of them. An effect that is proportional to a joint angle is a hinge that a constraint ties to that angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.effects.functions import Column
from mbcacq.effects.learnt_range import is_angle
from mbcacq.exports.joint_frames import behind_joints, joint_frames
from mbcacq.files.template import filled
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.gravity import STANDARD_GRAVITY
from mbcacq.model.cell import RobotModel
from mbcacq.model.robot_import.mjcf import PLACEHOLDER_MASS

TEMPLATE = Path(__file__).parent / "mjcf.xml.j2"
DAMPING_S = 1e-3  # of a spring: its damping by its stiffness
RADIUS_OF_GYRATION_M = 0.05  # inertia tensors are not known; weight alone counts at standstill
UNIT_MASS_KG = 1.0  # of links whose masses are not known


@dataclass
class ExpressedEffects:
    """Effects as bodies and hinges of a model.

    Attributes
    ----------
    compliance : dict[int, float]
        Compliance of an axis (0: the first), rad/(N m).
    base : float
        Base of the pedestal, rad/(N m).
    ratio : dict[tuple[int, int], float]
        (axis, axis whose angle moves it) -> rad by rad.
    payload : tuple[float, ndarray]
        kg and centre (3,) mm in the flange frame.
    left : list[str]
        Names of the effects that bodies and hinges cannot express.
    """

    payload: tuple[float, np.ndarray]
    compliance: dict[int, float] = field(default_factory=dict)
    base: float = 0.0
    ratio: dict[tuple[int, int], float] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)


def expressed_effects(effects: EffectModel) -> ExpressedEffects:
    """The effects of a result, sorted by whether a MuJoCo model can hold them."""
    robot = effects.robot
    out = ExpressedEffects((float(np.mean(robot.payload_mass)), np.asarray(robot.payload_com, float)))
    for term in effects.terms:
        if not _express(term, out, robot):
            out.left.append(f"{term.name} at {'+'.join(term.where)}")
    return out


def _express(term: EffectTerm, out: ExpressedEffects, robot: RobotModel) -> bool:
    """Whether a term could be entered. Without masses of the links nothing winds up. A tied hinge is proportional to an angle within the
    limits of the joints: an effect that ends where it was learnt is none.
    """
    c = term.coefficients
    causes = {(p.place, p.index, p.component): _cause(p.columns[0]) for p in term.parts if len(p.columns) == 1}
    if len(c) == 4 and all(
        cause is not None and cause.startswith("payload_torque_")
        for p in term.parts
        for cause in (_cause((replace(column[0], factor=1.0),)) if len(column) == 1 else None for column in p.columns)
    ):
        return _express_payload(c, out)
    if len(causes) != len(term.parts) or len(c) != 1:
        return False
    (place, axis, _), cause = next(iter(causes.items()))
    single, winds_up = place == "joint" and len(causes) == 1, robot.mass.any() and float(c[0]) > 0
    if causes == {("frame", 0, 3 + k): f"gravity_moment_0_{'xyz'[k]}" for k in range(3)} and winds_up:
        out.base += float(c[0])
    elif single and cause == f"gravity_torque_{robot.tags[axis]}" and winds_up:
        out.compliance[axis] = out.compliance.get(axis, 0.0) + float(c[0])
    elif single and cause is not None and is_angle(cause) and _holds_at(term, cause, robot.limits[robot.tags.index(cause[1:])]):
        key = axis, robot.tags.index(cause[1:])
        out.ratio[key] = out.ratio.get(key, 0.0) + float(c[0])
    else:
        return False
    return True


def _holds_at(term: EffectTerm, angle: str, ends: np.ndarray) -> bool:
    """Whether a term goes on as far as these ends (2,) of a joint's range."""
    known = term.ranges.get(angle)
    return angle not in term.clamped or known is None or bool(np.all(np.abs(known.held(angle, ends) - ends) <= known.margin(angle)))


def _express_payload(c: np.ndarray, out: ExpressedEffects) -> bool:
    """c: (4,) kg and kg mm that the tool has beyond what was declared."""
    mass, com = out.payload
    heavier = mass + float(c[0])
    if heavier > 0:
        out.payload = heavier, (mass * com + c[1:4]) / heavier
    return heavier > 0


def _cause(column: Column) -> str | None:
    """The covariate to which a column is equal, None for other functions."""
    if len(column) == 1 and column[0].factor == 1.0 and len(column[0].functions) == 1:
        function = column[0].functions[0]
        if function.kind == "power" and function.numbers == (1.0,):
            return function.covariate
    return None


def mjcf(
    chain: Chain,
    T_flange_scanner: np.ndarray | None,
    robot: str = "arm",
    comments: Sequence[str] = (),
    effects: EffectModel | None = None,
    *,
    site: str = "scanner",
) -> str:
    """The arm for MuJoCo, sites at flange and, where its frame is known, at the scanner (called ``site``).

    Without effects, what the calibration knows is geometry; ranges, inertia tensors and drives are of another file always. comments: put
    in front."""
    found = expressed_effects(effects) if effects else ExpressedEffects((0.0, np.zeros(3)))
    frames, flange = joint_frames(chain)
    masses = None if effects is None or not effects.robot.mass.any() else effects.robot.mass
    if masses is None:
        comments = [*comments, f"the masses of the links are not in the result: {UNIT_MASS_KG:g} kg stands for each"]
    payload, com = found.payload
    return filled(
        TEMPLATE,
        comments=comments,
        robot=quoteattr(robot),
        gravity=_numbers(STANDARD_GRAVITY * np.array([0.0, 0.0, -1.0] if effects is None else effects.robot.gravity)),
        placeholder=PLACEHOLDER_MASS if masses is None else "",
        unit_mass=UNIT_MASS_KG,
        damping=DAMPING_S,
        gyration_2=RADIUS_OF_GYRATION_M**2,
        base=found.base,
        links=[(_place(T), *weight) for T, weight in zip(frames, _weights(chain, effects, masses), strict=True)],
        compliance=found.compliance,
        ratio=found.ratio,
        flange=_place(flange),
        site=quoteattr(site),
        scanner="" if T_flange_scanner is None else _place(flange @ T_flange_scanner),
        payload=payload,
        payload_centre=_numbers(1e-3 * se3.apply(flange, com)),
    )


def _weights(chain: Chain, effects: EffectModel | None, masses: np.ndarray | None) -> list[tuple[float, str]]:
    """(kg, centre of mass in m as text) of each link."""
    if effects is None or masses is None:
        return [(UNIT_MASS_KG, "0 0 0")] * chain.n
    centres = [se3.apply(T, c) for T, c in zip(behind_joints(chain), effects.robot.com, strict=True)]
    return [(max(float(m), 1e-3), _numbers(1e-3 * c)) for m, c in zip(masses, centres, strict=True)]


def _place(T: np.ndarray) -> str:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return f'pos="{_numbers(1e-3 * T[:3, 3])}" quat="{w:.15g} {x:.15g} {y:.15g} {z:.15g}"'


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{v + 0.0:.12g}" for v in values)
