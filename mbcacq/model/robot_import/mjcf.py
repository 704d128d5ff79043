"""An arm of an MJCF file, as MuJoCo compiles it: hinges and slides from a base body to a flange body or site."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.bounds import refuse_beyond
from mbcacq.model.robot_import.kinematic_tree import KinematicTree, TreeJoint
from mbcacq.model.robot_import.source import ArmSource
from mbcacq.quantities import in_degrees

PLACEHOLDER_MASS = "placeholder_mass_kg"  # <numeric> in <custom>: links of this mass have one that nobody stated
SIX_DIGITS = 1e-5  # to which MuJoCo writes the numbers of a model, relative
# And their users; a key has a number for each actuator, of which some go.
SHAPES = tuple("geoms meshes hfields skins flexes sensors pairs tendons tuples materials textures keys".split())
SMALLEST_MASS = 1e-6  # kg, of a body whose shapes are not there, for MuJoCo compiles none without mass


@dataclass(frozen=True)
class _Model:
    """The model that MuJoCo compiled. massless: numbers of bodies whose masses are unknown; bare: of those without any shape in the file.
    remarks: about what was left out."""

    mujoco: Any
    model: Any
    bare: frozenset[int]
    massless: frozenset[int] = frozenset()
    remarks: tuple[str, ...] = ()


def read_mjcf(path: Path, base: str | None, flange: str | None) -> ArmSource:
    """Raises ConfigError where MuJoCo refuses the file, or no serial arm of hinges leads to the flange."""
    compiled = _compiled(path)
    mujoco, model = compiled.mujoco, compiled.model
    _refuse_senseless(path, mujoco, _spec(mujoco, path.resolve()))
    names = _Names(mujoco, model)
    for name in (base, flange):
        if name is not None and name not in names.frames:
            bodies, sites = ", ".join(names.bodies), ", ".join(names.sites)
            raise ConfigError(f"{path}: has no body or site '{name}'; its bodies are {bodies}; its sites {sites or 'none'}")
    arm = _tree(path, compiled, names).arm(base, flange)
    chain = [j.name for j in arm.axes]
    hinges = [names.joints[name] for name in chain]
    unit = np.ones(len(hinges))
    unit[list(arm.sliding)] = 1e3  # MuJoCo's slides are in m
    data: Any = mujoco.MjData(model)
    address = [model.jnt_qposadr[j] for j in hinges]
    resting = np.array(data.qpos)
    constant = {joint: _coupling(mujoco, model, hinges[joint])[0] for joint, _, _ in arm.follows}

    def place(angles: np.ndarray) -> np.ndarray:
        data.qpos[:] = resting
        data.qpos[address] = angles / unit
        for joint, leader, ratio in arm.follows:
            data.qpos[address[joint]] += constant[joint] + ratio * angles[leader] / unit[joint]
        mujoco.mj_kinematics(model, data)
        return names.frame(data, arm.base)

    def forward(q: np.ndarray) -> np.ndarray:
        return np.array([se3.inverse(place(angles)) @ names.frame(data, arm.flange) for angles in q])

    back = se3.inverse(place(np.zeros(len(hinges))))
    mass, com = _masses(compiled, data, hinges, back)
    limited = np.array([bool(model.jnt_limited[j]) for j in hinges])
    remarks = [
        "MJCF states no joint speeds; give them by --speed, or speed_deg_s of every axis in the file",
        *arm.remarks,
        *compiled.remarks,
    ]
    if not limited.all():
        remarks.append("joints without a range in the file get -360..360°")
    if invented := placeholder_masses(mujoco, model, hinges):
        remarks.append(placeholder_remark(invented))
    if others := [names.label(j) for j in range(model.njnt) if j not in hinges]:
        remarks.append(f"joints that do not lead to the flange were left as they rest: {', '.join(others)}")
    return ArmSource(
        name=path.stem,
        base=arm.base,
        flange=arm.flange,
        joints=["" if not model.joint(names.joints[name]).name else name for name in chain],
        direction=np.array(data.xaxis[hinges]) @ back[:3, :3].T,
        point=se3.apply(back, 1e3 * np.array(data.xanchor[hinges])),
        T_base_flange=back @ names.frame(data, arm.flange),
        limits=np.where(limited[:, None], model.jnt_range[hinges] * unit[:, None], [[-2 * np.pi, 2 * np.pi]]),
        speed=np.full(len(hinges), np.nan),
        mass=mass,
        com=com,
        forward=forward,
        remarks=remarks,
        sliding=arm.sliding,
        follows=arm.follows,
    )


def _compiled(path: Path) -> _Model:
    """The model. It has no shapes if its meshes or pictures are missing, since kinematics needs none. Raises ConfigError."""
    mujoco: Any = import_module("mujoco")
    try:
        model = mujoco.MjModel.from_xml_path(str(path.resolve()))  # what an included file names is looked for twice below a relative path
        return _Model(mujoco, model, frozenset(np.flatnonzero(model.body_geomnum == 0).tolist()))
    except (ValueError, OSError) as error:
        reason = str(error).splitlines()[0]
    try:
        spec = _spec(mujoco, path.resolve())
        bare = frozenset(number for number, body in enumerate(spec.bodies) if not body.geoms)
        massless = _without_shapes(mujoco, spec)
        model = spec.compile()
    except (ValueError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"{path}: MuJoCo cannot read it: {reason}; correct the file") from None
    about = f"MuJoCo cannot read its shapes ({reason}); they were left out"
    if massless:
        about += f", so that the masses of {', '.join(sorted(massless))} are unknown"
    return _Model(mujoco, model, bare, frozenset(model.body(name).id for name in massless), (about,))


def _refuse_senseless(path: Path, mujoco: Any, spec: Any) -> None:
    """Raises ConfigError for limits in the wrong order, which MuJoCo takes for none, for a mass below zero, which is unknown to it, and for
    an orientation or a size that nothing has."""
    for joint in spec.joints:
        low, high = joint.range
        if (low or high) and not low < high and joint.limited != mujoco.mjtLimited.mjLIMITED_FALSE:
            said = f"joint '{joint.name}' has the limits {low:g} to {high:g}"
            raise ConfigError(f"{path}: {said}; give the lower one first, or none where the joint turns without end")
    for body in spec.bodies:
        if body.explicitinertial and not body.mass >= 0:
            raise ConfigError(f"{path}: body '{body.name}' has a mass of {body.mass:g} kg; correct it")
    unit = 1.0 if spec.compiler.degree else in_degrees(1.0)
    for kind, elements in {"body": spec.bodies, "frame": spec.frames, "site": spec.sites, "geom": spec.geoms}.items():
        for element in elements:
            said, turned = f"{path}: the %s of {kind} '{element.name}'", element.alt
            refuse_beyond("angle", unit * np.array([*turned.euler, turned.axisangle[3]]), said % "orientation (deg)")
            directions = np.concatenate([turned.axisangle[:3], turned.xyaxes, turned.zaxis, element.quat])
            refuse_beyond("direction", directions, said % "orientation")
            refuse_beyond("position", 1e3 * np.array(getattr(element, "size", 0.0)), said % "size (mm)")
    for joint in spec.joints:
        refuse_beyond("direction", joint.axis, f"{path}: the axis of joint '{joint.name}'")


def _spec(mujoco: Any, path: Path) -> Any:
    """The specification in a file, which MuJoCo reads as one under the ending .xml only, and as an included file under any."""
    if path.suffix.lower() == ".xml":
        return mujoco.MjSpec.from_file(str(path))
    return mujoco.MjSpec.from_string(f"<mujoco><include file={quoteattr(str(path))}/></mujoco>")


def _without_shapes(mujoco: Any, spec: Any) -> set[str]:
    """Delete shapes and all that names them, give what has no mass then a very small one; returns the names of these bodies."""
    by_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    unwanted = [element for kind in SHAPES for element in getattr(spec, kind)]
    unwanted += [actuator for actuator in spec.actuators if actuator.trntype not in by_joint]
    unwanted += [equality for equality in spec.equalities if equality.type != mujoco.mjtEq.mjEQ_JOINT]
    for element in unwanted:
        spec.delete(element)
    for site in spec.sites:
        site.material = ""
    massless = set[str]()
    for number, body in enumerate(spec.bodies):
        if number and not (body.explicitinertial and body.mass >= SMALLEST_MASS):
            body.name = body.name or f"body {number}"
            body.explicitinertial, body.mass, body.inertia = 1, SMALLEST_MASS, [SMALLEST_MASS] * 3
            massless.add(body.name)
    return massless


class _Names:
    """Names of bodies, sites and joints of a model; what has none gets its number. frames: body, or site, of each name."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        self._model = model
        self.bodies = [model.body(b).name or f"body {b}" for b in range(model.nbody)]
        self.sites = [model.site(s).name for s in range(model.nsite)]
        self.frames: dict[str, tuple[str, int]] = {name: ("site", s) for s, name in enumerate(self.sites) if name}
        self.frames |= {name: ("body", b) for b, name in enumerate(self.bodies)}
        self.joints = {self.label(j): j for j in range(model.njnt)}

    def label(self, joint: int) -> str:
        return self._model.joint(joint).name or f"joint {joint}"

    def frame(self, data: Any, name: str) -> np.ndarray:
        """(4, 4) mm of a body or site in the world."""
        kind, number = self.frames[name]
        position, rotation = (data.site_xpos, data.site_xmat) if kind == "site" else (data.xpos, data.xmat)
        return se3.transform(np.array(rotation[number]).reshape(3, 3), 1e3 * np.array(position[number]))


def _tree(path: Path, compiled: _Model, names: _Names) -> KinematicTree:
    mujoco, model = compiled.mujoco, compiled.model
    kinds = {
        int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
        int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
        int(mujoco.mjtJoint.mjJNT_BALL): "a ball joint",
        int(mujoco.mjtJoint.mjJNT_FREE): "free",
    }
    follows = _followed(mujoco, model)

    def kind(joint: int) -> str:
        own = kinds[int(model.jnt_type[joint])]
        beside = int(model.body_jntnum[model.jnt_bodyid[joint]])
        if own == "revolute" and beside > 1 and (is_gear_spring(mujoco, model, joint) or joint in follows):
            return "fixed"
        return "continuous" if own == "revolute" and not model.jnt_limited[joint] else own

    def joints() -> Iterator[TreeJoint]:
        for body in range(1, model.nbody):
            parent, first = names.bodies[model.body_parentid[body]], int(model.body_jntadr[body])
            own = list(range(first, first + int(model.body_jntnum[body])))
            bare = body in compiled.bare
            if not own:
                yield TreeJoint("", "fixed", parent, names.bodies[body], bare=bare)
            for number, joint in enumerate(own):
                # Several joints of a body turn about one another: frames without a name of their own stand between them.
                child = names.bodies[body] if joint == own[-1] else f"{names.bodies[body]} before joint {number + 2}"
                names.frames.setdefault(child, ("body", int(model.body_parentid[body])))  # whose frame it has while they rest
                unit = 1e3 if kind(joint) == "prismatic" else 1.0
                low, high = unit * model.jnt_range[joint] if model.jnt_limited[joint] else (np.nan, np.nan)
                leader = follows.get(joint)
                of_leader = 1e-3 if leader is not None and kind(leader) == "prismatic" else 1.0
                yield TreeJoint(
                    name=names.label(joint),
                    kind=kind(joint),
                    parent=parent,
                    child=child,
                    lower=float(low),
                    upper=float(high),
                    follows="" if leader is None else names.label(leader),
                    ratio=1.0 if leader is None else unit * of_leader * _coupling(mujoco, model, joint)[1],
                    bare=bare,
                )
                parent = child
        for site, name in enumerate(names.sites):
            if name and names.frames[name][0] == "site":
                yield TreeJoint("", "fixed", names.bodies[model.site_bodyid[site]], name, bare=True)

    found = list(joints())
    return KinematicTree(found, names.frames, path)


def _followed(mujoco: Any, model: Any) -> dict[int, int]:
    """The joint that each coupled joint follows."""
    couplings = [e for e in range(model.neq) if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0]
    return {int(model.eq_obj1id[e]): int(model.eq_obj2id[e]) for e in couplings}


def _coupling(mujoco: Any, model: Any, joint: int) -> tuple[float, float]:
    """Constant and slope of the polynomial by which a coupled joint follows another; higher powers raise ConfigError where they matter."""
    one = next(e for e in range(model.neq) if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj1id[e] == joint)
    return float(model.eq_data[one, 0]), float(model.eq_data[one, 1])


def is_gear_spring(mujoco: Any, model: Any, joint: int) -> bool:
    """A hinge that a spring holds and no actuator turns: the wind-up of the gear of another hinge on the same body."""
    driven = {int(model.actuator_trnid[a, 0]) for a in range(model.nu) if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT}
    hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    return bool(hinge and np.max(np.atleast_1d(model.jnt_stiffness[joint])) > 0 and joint not in driven)


def placeholder_masses(mujoco: Any, model: Any, joints: Sequence[int]) -> tuple[str, ...]:
    """Names of the bodies of these joints whose mass is the one that the file itself calls a placeholder."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, PLACEHOLDER_MASS)
    if number < 0:
        return ()
    placeholder = model.numeric_data[model.numeric_adr[number]]
    bodies = [int(model.jnt_bodyid[j]) for j in joints]
    return tuple(model.body(b).name for b in bodies if np.isclose(model.body_mass[b], placeholder, rtol=SIX_DIGITS, atol=0))


def placeholder_remark(bodies: Sequence[str]) -> str:
    """One sentence about bodies whose masses are placeholders."""
    return (
        f"the masses of {', '.join(bodies)} are placeholders, for nobody stated them: effects of gravity are off by as much; "
        "write those of the data sheet into the <inertial> of these bodies"
    )


def _ancestors(model: Any, body: int) -> list[int]:
    """The body and all it hangs on, the world left out."""
    out = []
    while body != 0:
        out.append(body)
        body = int(model.body_parentid[body])
    return out


def _masses(compiled: _Model, data: Any, hinges: list[int], back: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masses (n,) and centres of gravity (n, 3) of each joint's body with what is fixed to it, zero where the file does not say;
    kinematics at zero must be current."""
    model = compiled.model
    owner = {int(model.jnt_bodyid[j]): k for k, j in enumerate(hinges)}
    mass, moment = np.zeros(len(hinges)), np.zeros((len(hinges), 3))
    for body in range(1, model.nbody):
        carrier = next((a for a in _ancestors(model, body) if a in owner or model.body_jntnum[a]), None)
        if carrier in owner and body not in compiled.massless:
            place = 1e3 * (np.array(data.xpos[body]) + np.array(data.xmat[body]).reshape(3, 3) @ np.array(model.body_ipos[body]))
            mass[owner[carrier]] += model.body_mass[body]
            moment[owner[carrier]] += model.body_mass[body] * place
    own = 1e3 * np.array(data.xanchor[hinges])
    return mass, se3.apply(back, np.where(mass[:, None] > 0, moment / np.maximum(mass, 1e-12)[:, None], own))
