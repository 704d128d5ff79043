"""An arm of an MJCF file, as MuJoCo compiles it: the hinges from a base body to a flange body or site."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.robot_import.source import ArmSource

PLACEHOLDER_MASS = "placeholder_mass_kg"  # <numeric> in <custom>: links of this mass have one that nobody stated
SIX_DIGITS = 1e-5  # to which MuJoCo writes the numbers of a model, relative


def read_mjcf(path: Path, base: str | None, flange: str | None) -> ArmSource:
    """Raises ConfigError where MuJoCo refuses the file, or no serial arm of hinges leads to the flange."""
    mujoco: Any = import_module("mujoco")
    try:
        model: Any = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError) as error:
        raise ConfigError(f"{path}: MuJoCo cannot read it: {str(error).splitlines()[0]}; correct the file") from None
    data: Any = mujoco.MjData(model)
    hinges, others = _hinges(path, mujoco, model, base, flange)
    body, site = _tip(path, mujoco, model, flange, hinges)
    foot = _foot(path, mujoco, model, base, hinges)
    address = [model.jnt_qposadr[j] for j in hinges]
    resting = np.array(data.qpos)

    def place(angles: np.ndarray) -> np.ndarray:
        data.qpos[:] = resting
        data.qpos[address] = angles
        mujoco.mj_kinematics(model, data)
        return _frame(data.xpos[foot], data.xmat[foot])

    def end() -> np.ndarray:
        return _frame(data.site_xpos[site], data.site_xmat[site]) if site is not None else _frame(data.xpos[body], data.xmat[body])

    def forward(q: np.ndarray) -> np.ndarray:
        return np.array([se3.inverse(place(angles)) @ end() for angles in q])

    back = se3.inverse(place(np.zeros(len(hinges))))
    mass, com = _masses(model, data, hinges, back)
    limited = np.array([bool(model.jnt_limited[j]) for j in hinges])
    remarks = ["MJCF states no joint speeds; give them by --speed, or speed_deg_s of every axis in the file"]
    if not limited.all():
        remarks.append("joints without a range in the file get -360..360 deg")
    if invented := placeholder_masses(mujoco, model, hinges):
        remarks.append(placeholder_remark(invented))
    if others:
        remarks.append(f"joints that do not lead to the flange were left as they rest: {', '.join(others)}")
    return ArmSource(
        name=path.stem,
        base=model.body(foot).name or "world",
        flange=model.site(site).name if site is not None else model.body(body).name,
        joints=[model.joint(j).name for j in hinges],
        direction=np.array(data.xaxis[hinges]) @ back[:3, :3].T,
        point=se3.apply(back, 1e3 * np.array(data.xanchor[hinges])),
        T_base_flange=back @ end(),
        limits=np.where(limited[:, None], model.jnt_range[hinges], [[-2 * np.pi, 2 * np.pi]]),
        speed=np.full(len(hinges), np.nan),
        mass=mass,
        com=com,
        forward=forward,
        remarks=remarks,
    )


def _hinges(path: Path, mujoco: Any, model: Any, base: str | None, flange: str | None) -> tuple[list[int], list[str]]:
    """Joints from the base to the flange, and the names of all others."""
    if flange is None:
        depth = [len(_ancestors(model, b)) if model.body_jntnum[b] else -1 for b in range(model.nbody)]
        body = int(np.argmax([sum(int(model.body_jntnum[a]) for a in _ancestors(model, b)) if d > 0 else -1 for b, d in enumerate(depth)]))
    else:
        body = _named(path, mujoco, model, flange)[0]
    stop = None if base is None else _named(path, mujoco, model, base)[0]
    chain: list[int] = []
    tied = {int(model.eq_obj1id[e]) for e in range(model.neq) if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT}
    for b in _ancestors(model, body):
        if b == stop:
            break
        own = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        chain[:0] = [j for j in own if len(own) == 1 or not (is_gear_spring(mujoco, model, j) or j in tied)]
    odd = [model.joint(j).name for j in chain if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE]
    if odd:
        raise ConfigError(f"{path}: joint '{odd[0]}' is no hinge; an arm of hinges is needed, name its --base and --flange")
    if len(chain) < 2:
        raise ConfigError(f"{path}: fewer than two hinges lead to the flange; name the arm's last body or site with --flange")
    return chain, [model.joint(j).name for j in range(model.njnt) if j not in chain]


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


def _named(path: Path, mujoco: Any, model: Any, name: str) -> tuple[int, int | None]:
    """Body, and site where the name is one."""
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body >= 0:
        return body, None
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    if site < 0:
        bodies = ", ".join(model.body(b).name for b in range(1, model.nbody))
        sites = ", ".join(model.site(s).name for s in range(model.nsite))
        raise ConfigError(f"{path}: has no body or site '{name}'; its bodies are {bodies}; its sites {sites or 'none'}")
    return int(model.site_bodyid[site]), site


def _tip(path: Path, mujoco: Any, model: Any, flange: str | None, hinges: list[int]) -> tuple[int, int | None]:
    return (int(model.jnt_bodyid[hinges[-1]]), None) if flange is None else _named(path, mujoco, model, flange)


def _foot(path: Path, mujoco: Any, model: Any, base: str | None, hinges: list[int]) -> int:
    return int(model.body_parentid[model.jnt_bodyid[hinges[0]]]) if base is None else _named(path, mujoco, model, base)[0]


def _frame(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    return se3.transform(np.array(rotation).reshape(3, 3), 1e3 * np.array(position))


def _masses(model: Any, data: Any, hinges: list[int], back: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each joint's body with what is fixed to it; kinematics at zero must be current."""
    owner = {int(model.jnt_bodyid[j]): k for k, j in enumerate(hinges)}
    mass, moment = np.zeros(len(hinges)), np.zeros((len(hinges), 3))
    for body in range(1, model.nbody):
        carrier = next((a for a in _ancestors(model, body) if a in owner or model.body_jntnum[a]), None)
        if carrier in owner:
            place = 1e3 * (np.array(data.xpos[body]) + np.array(data.xmat[body]).reshape(3, 3) @ np.array(model.body_ipos[body]))
            mass[owner[carrier]] += model.body_mass[body]
            moment[owner[carrier]] += model.body_mass[body] * place
    own = 1e3 * np.array(data.xanchor[hinges])
    return mass, se3.apply(back, np.where(mass[:, None] > 0, moment / np.maximum(mass, 1e-12)[:, None], own))
