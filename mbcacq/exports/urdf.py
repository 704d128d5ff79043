"""URDF and xacro: the calibrated kinematics as new joint origins, everything else of the file kept (lxml; comments stay).

With all joints at zero, calibration moves the axis of joint i by a rigid displacement D_i of the base frame, D_i = F'_i inv(F_i), F_i the
frame whose z is that axis. Moving each joint's frame of the URDF by its D_i gives a URDF whose forward kinematics is exactly the
calibrated one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.exports.xacro_numbers import vector
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain

MAX_BYTES = 16 << 20
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

    Raises ConfigError where the file does not describe this arm at its zero position, naming joint and misfit.
    """
    root, raw = _parse(Path(path))
    named = {j.get("name"): j for j in root.iter("joint") if j.find("parent") is not None and j.find("child") is not None}
    order = _chain(named, joints, nominal.n, path)
    before = [_origin(j, path) for j in order]
    zero = np.zeros((1, nominal.n))
    F, G = nominal.frames(zero)[0], calibrated.frames(zero)[0]
    D = G @ se3.inverse(F)
    U, moved, previous = np.eye(4), [], np.eye(4)
    number = 0
    for element, T in zip(order, before, strict=True):
        U = U @ T
        if element.get("type") != "fixed":
            _check_axis(element, U, F[number], nominal.sign[number], path)
            here = D[number] @ U
            number += 1
        else:
            here = D[number if number == nominal.n else number - 1] @ U
        moved.append(se3.inverse(previous) @ here)
        previous = here
    for element, T, old in zip(order, moved, before, strict=True):
        if np.abs(T - old).max() > 1e-9:
            _set_origin(element, T)
    if T_flange_scanner is not None:
        # The URDF's flange frame may be turned against the MD-H one (KUKA's tool0 looks out of the arm, alpha_n may look into it).
        _add_scanner(root, named, _link(order[-1], "child"), se3.inverse(previous) @ G[-1] @ np.asarray(T_flange_scanner, float), scanner)
    return _text(root, raw, comments)


def _parse(path: Path) -> tuple[Any, bytes]:
    import lxml.etree as etree

    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give a URDF or xacro file") from error
    if len(raw) > MAX_BYTES or b"<!ENTITY" in raw or b"<!DOCTYPE" in raw:
        raise ConfigError(f"{path}: is too large, or declares entities, which are refused; expand it first")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_blank_text=False)
    try:
        root = etree.fromstring(raw, parser)
    except etree.XMLSyntaxError as error:
        raise ConfigError(f"{path}:{error.lineno}: is not well-formed XML: {error.msg}") from error
    return root, raw


def _text(root: Any, raw: bytes, comments: Sequence[str]) -> bytes:
    """The comments and the changed element between the original text before and behind it, with the original line ends."""
    import lxml.etree as etree

    encoding = root.getroottree().docinfo.encoding or "utf-8"
    masked = re.sub(rb"<!--.*?-->", lambda m: b" " * len(m.group()), raw, flags=re.DOTALL)
    first = re.search(rb"<[A-Za-z_]", masked)
    assert first is not None, "a well-formed document has an element"
    start = first.start()
    end = masked.rindex(b">") + 1
    body = etree.tostring(root, encoding=encoding, xml_declaration=False, with_tail=False)
    body = "".join(f"<!-- {line} -->\n" for line in comments).encode(encoding) + body
    return raw[:start] + (body.replace(b"\n", b"\r\n") if b"\r\n" in raw else body) + raw[end:]


def _chain(named: dict[str, Any], joints: Sequence[str] | None, n: int, path: str | Path) -> list[Any]:
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


def _named_tip(named: dict[str, Any], joints: Sequence[str], path: str | Path) -> Any:
    """The last of the joints that the user named."""
    for name in joints:
        if name not in named:
            raise ConfigError(f"{path}: has no joint '{name}'; its joints are {', '.join(map(str, named))}")
    return named[joints[-1]]


def _only_tip(named: dict[str, Any], n: int, path: str | Path) -> Any:
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


def _link(joint, end: str) -> str:
    return joint.find(end).get("link")


def _origin(element, path) -> np.ndarray:
    """(4, 4) mm of a joint's origin."""
    origin = element.find("origin")
    xyz = _vector(origin.get("xyz", "0 0 0"), element, path) if origin is not None else np.zeros(3)
    r, p, y = _vector(origin.get("rpy", "0 0 0"), element, path) if origin is not None else np.zeros(3)
    return se3.from_abc(1e3 * xyz, np.array([y, p, r]))


def _set_origin(element, T: np.ndarray) -> None:
    origin = element.find("origin")
    if origin is None:
        import lxml.etree as etree

        origin = etree.SubElement(element, "origin")
    xyz, (y, p, r) = se3.to_abc(T)
    origin.set("xyz", " ".join(f"{v / 1e3 + 0.0:.9g}" for v in np.where(np.abs(xyz) < 1e-7, 0.0, xyz)))
    origin.set("rpy", " ".join(f"{v + 0.0:.10g}" for v in np.where(np.abs([r, p, y]) < 1e-11, 0.0, [r, p, y])))


def _axis(element) -> np.ndarray:
    given = element.find("axis")
    axis = np.array([float(v) for v in (given.get("xyz") if given is not None else "1 0 0").split()])
    return axis / np.linalg.norm(axis)


def _check_axis(element, U: np.ndarray, F: np.ndarray, sign: float, path) -> None:
    axis = U[:3, :3] @ _axis(element)
    angle = np.arccos(np.clip(axis @ (sign * F[:3, 2]), -1, 1))
    apart = U[:3, 3] - F[:3, 3]
    distance = np.linalg.norm(apart - (apart @ F[:3, 2]) * F[:3, 2])
    if angle > AXIS_TOLERANCE_RAD or distance > AXIS_TOLERANCE_MM:
        raise ConfigError(
            f"{path}:{element.sourceline}: the axis of joint '{element.get('name')}' is {distance:.1f} mm and "
            f"{np.degrees(angle):.1f} deg away from the calibrated arm's at its zero position: "
            "another robot, or other directions of rotation or zeros of the joints; "
            "give the URDF that uses the controller's joint angles"
        )


def _add_scanner(root, named: dict, flange: str, T: np.ndarray, scanner: str) -> None:
    import lxml.etree as etree

    existing = next((j for j in named.values() if _link(j, "child") == scanner), None)
    if existing is not None:
        _set_origin(existing, T)
        return
    link = etree.SubElement(root, "link", name=scanner)
    joint = etree.SubElement(root, "joint", name=f"{flange}-{scanner}", type="fixed")
    link.tail, joint.text, joint.tail = "\n  ", "\n    ", "\n"
    for tag, attributes in (("parent", {"link": flange}), ("child", {"link": scanner}), ("origin", {})):
        child = etree.SubElement(joint, tag, attributes)
        child.tail = "\n    " if tag != "origin" else "\n  "
    _set_origin(joint, T)


def _vector(text: str, element, path) -> np.ndarray:
    try:
        return vector(text)
    except ValueError as error:
        raise ConfigError(
            f"{path}:{element.sourceline}: the origin of joint '{element.get('name')}' is not three numbers: '{text}'; "
            "expand the file with xacro first"
        ) from error
