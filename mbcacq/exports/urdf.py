"""URDF and xacro: the calibrated kinematics as new joint origins, every other byte of the file kept.

With all joints at zero, calibration moves the axis of joint i by a rigid displacement D_i of the base frame, D_i = F'_i inv(F_i), F_i the
frame whose z is that axis. Moving each joint's frame of the URDF by its D_i gives a URDF whose forward kinematics is exactly the
calibrated one.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element
from xml.sax.saxutils import quoteattr

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.exports.xacro_numbers import vector
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.xml_file import XmlFile
from mbcacq.quantities import in_degrees

AXIS_TOLERANCE_MM, AXIS_TOLERANCE_RAD = 1.0, 2e-3


def patch(
    path: str | Path,
    nominal: Chain,
    calibrated: Chain,
    *,
    joints: Sequence[str] | None = None,
    T_flange_scanner: np.ndarray | None = None,
    scanner: str = "scanner_frame",
    comments: Sequence[str] = (),
) -> bytes:
    """The file's XML with calibrated joint origins.

    joints: names of the n moving joints from base to flange (default: the revolute ones, of which there must be n). The robot's base is
    the parent link of the first, the flange the child of the fixed joint behind the last, or of the last where there is none. With
    ``T_flange_scanner`` (4, 4) mm, in the flange frame of the MD-H chain, a fixed joint to ``scanner`` is added behind the flange, or
    its origin set where it exists. comments: put in front of the root element.

    Raises ConfigError if the file does not describe this arm at its zero position, naming joint and misfit.
    """
    file = _parse(Path(path))
    named = {str(j.get("name")): j for j in file.root.iter("joint") if j.find("parent") is not None and j.find("child") is not None}
    order = _chain(named, joints, nominal.n, path)
    before = [_origin(j, f"{path}:{file.line(j)}") for j in order]
    zero = np.zeros((1, nominal.n))
    F, G = nominal.frames(zero)[0], calibrated.frames(zero)[0]
    D = G @ se3.inverse(F)
    U, moved, previous = np.eye(4), [], np.eye(4)
    number = 0
    for element, T in zip(order, before, strict=True):
        U = U @ T
        if element.get("type") != "fixed":
            _check_axis(element, U, F[number], nominal.sign[number], f"{path}:{file.line(element)}")
            here = D[number] @ U
            number += 1
        else:
            here = D[number if number == nominal.n else number - 1] @ U
        moved.append(se3.inverse(previous) @ here)
        previous = here
    for element, T, old in zip(order, moved, before, strict=True):
        if np.abs(T - old).max() > 1e-9:
            _set_origin(file, element, T)
    if T_flange_scanner is not None:
        # The URDF's flange frame may be turned against the MD-H one (KUKA's tool0 looks out of the arm, alpha_n may look into it).
        _add_scanner(file, named, _link(order[-1], "child"), se3.inverse(previous) @ G[-1] @ np.asarray(T_flange_scanner, float), scanner)
    file.comment(comments)
    return file.edited()


def _parse(path: Path) -> XmlFile:
    try:
        return XmlFile(path.read_bytes(), path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give a URDF or xacro file") from error


def _chain(named: dict[str, Element], joints: Sequence[str] | None, n: int, path: str | Path) -> list[Element]:
    """Joint elements from the first moving one to the last, with the fixed ones between and the first fixed one behind."""
    tip = _named_tip(named, joints, path) if joints else _only_tip(named, n, path)
    up = {_link(j, "child"): j for j in named.values()}
    chain = [up[link] for link in _climb(named, _link(tip, "child")) if link in up][::-1]
    while chain and chain[0].get("type") == "fixed":
        chain.pop(0)
    moving = [j.get("name") for j in chain if j.get("type") != "fixed"]
    if len(moving) != n or joints and moving != list(joints):
        raise ConfigError(
            f"{path}: the joints {', '.join(map(str, moving))} lead from the base to the last one, "
            f"but the arm has {n} axes; name them with --joint, base first"
        )
    after = [j for j in named.values() if j.get("type") == "fixed" and _link(j, "parent") == _link(tip, "child")]
    return chain + after[:1]


def _named_tip(named: dict[str, Element], joints: Sequence[str], path: str | Path) -> Element:
    """The last of the joints that the user named."""
    for name in joints:
        if name not in named:
            raise ConfigError(f"{path}: has no joint '{name}'; its joints are {', '.join(map(str, named))}")
    return named[joints[-1]]


def _only_tip(named: dict[str, Element], n: int, path: str | Path) -> Element:
    """The last moving joint of a file whose moving joints are those of the arm: no other moving joint hangs on it."""
    moving = [j for j in named.values() if j.get("type") in ("revolute", "continuous")]
    if len(moving) != n:
        raise ConfigError(f"{path}: has {len(moving)} moving joints, the arm has {n} axes; name them with --joint, base first")
    above = {link for j in moving for link in _climb(named, _link(j, "parent"))}
    return next((j for j in moving if _link(j, "child") not in above), moving[-1])


def _climb(named: dict, link: str | None) -> list[str]:
    """A link and all links it hangs on, towards the root."""
    up = {_link(j, "child"): _link(j, "parent") for j in named.values()}
    out: list[str] = []
    while link is not None and link not in out:
        out.append(link)
        link = up.get(link)
    return out


def _link(joint: Element, end: str) -> str:
    """The link at an end of a joint: parent or child."""
    found = joint.find(end)
    assert found is not None, "joints without both ends are left out"
    return str(found.get("link"))


def _origin(joint: Element, place: str) -> np.ndarray:
    """(4, 4) mm of a joint's origin."""
    origin = joint.find("origin")
    xyz = _vector(origin.get("xyz", "0 0 0"), joint, place) if origin is not None else np.zeros(3)
    r, p, y = _vector(origin.get("rpy", "0 0 0"), joint, place) if origin is not None else np.zeros(3)
    return se3.from_abc(1e3 * xyz, np.array([y, p, r]))


def _set_origin(file: XmlFile, joint: Element, T: np.ndarray) -> None:
    xyz, rpy = _written(T)
    origin = joint.find("origin")
    if origin is None:
        file.append(joint, f'<origin xyz="{xyz}" rpy="{rpy}"/>')
    else:
        file.set_attributes(origin, xyz=xyz, rpy=rpy)


def _written(T: np.ndarray) -> tuple[str, str]:
    """A transform, mm, as a URDF has it: m, and roll, pitch and yaw in rad."""
    xyz, (y, p, r) = se3.to_abc(T)
    return (
        " ".join(f"{v / 1e3 + 0.0:.9g}" for v in np.where(np.abs(xyz) < 1e-7, 0.0, xyz)),
        " ".join(f"{v + 0.0:.10g}" for v in np.where(np.abs([r, p, y]) < 1e-11, 0.0, [r, p, y])),
    )


def _axis(joint: Element, place: str) -> np.ndarray:
    given = joint.find("axis")
    axis = _vector(given.get("xyz", "1 0 0") if given is not None else "1 0 0", joint, place, "axis")
    return axis / max(float(np.linalg.norm(axis)), 1e-12)


def _check_axis(element: Element, U: np.ndarray, F: np.ndarray, sign: float, place: str) -> None:
    axis = U[:3, :3] @ _axis(element, place)
    angle = np.arccos(np.clip(axis @ (sign * F[:3, 2]), -1, 1))
    apart = U[:3, 3] - F[:3, 3]
    distance = np.linalg.norm(apart - (apart @ F[:3, 2]) * F[:3, 2])
    if angle > AXIS_TOLERANCE_RAD or distance > AXIS_TOLERANCE_MM:
        raise ConfigError(
            f"{place}: the axis of joint '{element.get('name')}' is {distance:.1f} mm and "
            f"{in_degrees(angle):.1f}° away from the calibrated arm's at its zero position: "
            "another robot, or other directions of rotation or zeros of the joints; "
            "give the URDF that uses the controller's joint angles"
        )


def _add_scanner(file: XmlFile, named: dict[str, Element], flange: str, T: np.ndarray, scanner: str) -> None:
    existing = next((j for j in named.values() if _link(j, "child") == scanner), None)
    if existing is not None:
        _set_origin(file, existing, T)
        return
    xyz, rpy = _written(T)
    file.append(
        file.root,
        f"""  <link name={quoteattr(scanner)}/>
  <joint name={quoteattr(f"{flange}-{scanner}")} type="fixed">
    <parent link={quoteattr(flange)}/>
    <child link={quoteattr(scanner)}/>
    <origin xyz="{xyz}" rpy="{rpy}"/>
  </joint>
""",
    )


def _vector(text: str, joint: Element, place: str, what: str = "origin") -> np.ndarray:
    try:
        return vector(text)
    except ValueError as error:
        raise ConfigError(
            f"{place}: the {what} of joint '{joint.get('name')}' is not three numbers: '{text}'; expand the file with xacro first"
        ) from error
