"""Public robot descriptions, imported and compared with pinocchio (URDF, xacro) and MuJoCo (MJCF) where these read them.

    pip install pin                                        # pinocchio; without it URDF files are imported and not compared
    python benchmarks/robot_files.py DIR [DIR ...] [--all] [--package NAME=DIR]

Takes every .urdf, .xacro, .mjcf and .xml with <robot> or <mujoco> below the folders. Prints the refused files with their reasons, and
counts per kind. The counts are files, imported and right (20 random vectors of joint angles within 1e-3 mm and 1e-6 rad of the reference),
imported and not compared, and wrong. Further ones are several arms, each of which is right when ``--flange`` names it, no arm, and refused
although something in it may be an arm. Meshes that are not there are replaced by a small body for MuJoCo, whose kinematics they do not
change.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import struct
import sys
import zlib
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import MbcacqError
from mbcacq.geometry import se3
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.robot_import import ImportedRobot, import_robot
from mbcacq.model.robot_import.xacro_file import expanded

VECTORS, CLOSE_MM, CLOSE_RAD = 20, 1e-3, 1e-6
KINDS = {".urdf": "URDF", ".xacro": "xacro", ".mjcf": "MJCF", ".xml": "MJCF"}
CLASSES = {  # what the sentence of a refusal says of the file, the first that fits
    "nothing moves": r"no moving joints",
    "a part that another file includes": r"mujocoinclude|defines macros only|begins with <|unknown transmission|cannot be renamed"
    r"|not found in (tendon|actuator|collision)|unknown default class|repeated name",
    "several chains (legs, hands, arms)": r"chains of joints end in",
    "fewer than two turning joints": r"fewer than two",
    "slides, balls or floats": r"is (prismatic|free|floating|spherical|planar|a ball joint); an arm",
    "coupled joints": r"is no axis of its own",
    "a package or an included file is not there": r"package '|No such file|Error opening file|needs an argument",
    "not of today's format, or damaged": r"MuJoCo cannot read|not well-formed|should be \d+ number|xacro cannot expand|hangs on two"
    r"|without 'xacro:'|axis of length",
}
NO_ARM = tuple(CLASSES)[:5]
MOVING = 3  # axes of what is an arm here
ENDS = re.compile(r"chains of joints end in (.*?)(?: and \d+ more)?; name")
OPENING = re.compile(r"Error opening file '([^']*)'|resource not found via provider or OS filesystem: '([^']*)'")
TETRAHEDRON = b"v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"  # large enough where the file scales by 0.001
PICTURES = (12, 12), (36, 48), (48, 36), (12, 72), (72, 12)  # rows and columns of a stand-in, as textures are divided
PICTURE = re.compile(r"PNG size must be .* in texture '([^']*)'")
MOST_MESHES = 400
Forward = Callable[[np.ndarray], np.ndarray]


def main() -> int:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--all", action="store_true", help="also print the files that are right")
    parser.add_argument("--package", action="append", default=[], metavar="NAME=DIR")
    options = parser.parse_args()
    packages = {name: Path(folder) for name, _, folder in (pair.partition("=") for pair in options.package)}
    counted: dict[str, Counter[str]] = {}
    why: Counter[str] = Counter()
    for path in (p for folder in options.folders for p in sorted(folder.rglob("*")) if p.suffix.lower() in KINDS and p.is_file()):
        if not re.search(rb"<(robot|mujoco)", path.read_bytes()[:100_000]):
            continue
        outcome, sentence = judged(path, packages)
        counted.setdefault(KINDS[path.suffix.lower()], Counter())[outcome] += 1
        if outcome in ("no arm", "refused"):
            why[_class(sentence)] += 1
        if options.all or outcome not in ("right", "no arm", "several arms"):
            print(f"{outcome}: {path}: {sentence}")
    outcomes = ("right", "several arms", "not compared", "wrong", "no arm", "refused")
    print("\n| kind | files | " + " | ".join(outcomes) + " |\n|---|" + "---|" * (len(outcomes) + 1))
    for kind, found in sorted(counted.items()):
        print(f"| {kind} | {found.total()} | " + " | ".join(str(found[o]) for o in outcomes) + " |")
    print("\n| why none was imported | files |\n|---|---|")
    for reason, count in why.most_common():
        print(f"| {reason} | {count} |")
    return 1 if any(found["wrong"] for found in counted.values()) else 0


def judged(path: Path, packages: dict[str, Path], flange: str | None = None) -> tuple[str, str]:
    """What came of one file, and a sentence about it."""
    try:
        found = import_robot(path, packages=packages, flange=flange)
    except MbcacqError as error:
        sentence = str(error).removeprefix(f"{path}: ")
        if flange is None and (ends := ENDS.search(sentence)):
            each = [judged(path, packages, end)[0] for end in ends[1].split(", ")]
            if each.count("right") >= 2:
                return ("wrong" if "wrong" in each else "several arms"), sentence
        return ("no arm" if _class(sentence) in NO_ARM else "refused"), sentence
    about = f"{len(found.joints)} axes, {found.base} to {found.flange}"
    if len(found.joints) < MOVING:
        return "no arm", f"fewer than two or three turning joints: {about}"
    is_mjcf = KINDS[path.suffix.lower()] == "MJCF" and b"<mujoco" in path.read_bytes()
    reference = _mujoco(path, found) if is_mjcf else _pinocchio(path, packages, found)
    if reference is None:
        return "not compared", about
    arm = RobotSpec.model_validate(yaml.safe_load(found.text)).model()
    low, high = np.clip(arm.limits, -np.pi, np.pi).T
    q = np.random.default_rng(0).uniform(np.minimum(low, high), np.maximum(low, high), (VECTORS, arm.n))
    ours, theirs = found.T_given_base @ arm.chain.flange(q) @ found.T_flange_given, reference(q)
    miss_mm = float(np.abs(ours[:, :3, 3] - theirs[:, :3, 3]).max())
    miss_rad = float(np.abs(ours[:, :3, :3] - theirs[:, :3, :3]).max())
    right = miss_mm < CLOSE_MM and miss_rad < CLOSE_RAD
    return ("right" if right else "wrong"), f"{about}, differs by {miss_mm:.1e} mm, {miss_rad:.1e} rad"


def _class(sentence: str) -> str:
    return next((name for name, words in CLASSES.items() if re.search(words, sentence)), "another reason")


def _pinocchio(path: Path, packages: dict[str, Path], found: ImportedRobot) -> Forward | None:
    try:
        pin: Any = import_module("pinocchio")
    except ImportError:
        return None
    is_xacro = path.suffix.lower() == ".xacro" or b"<xacro:" in path.read_bytes()
    text = (expanded(path, packages, {}) if is_xacro else path.read_bytes()).decode("utf-8-sig").strip()
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            model = pin.buildModelFromXML(re.sub(r"^<\?xml.*?\?>", "", text))
    except (ValueError, RuntimeError):
        return None
    data = model.createData()
    if not all(model.existFrame(name, pin.FrameType.BODY) for name in (found.base, found.flange)):
        return None

    def forward(q: np.ndarray) -> np.ndarray:
        out = []
        for angles in q:
            place = pin.neutral(model)
            for name, angle in zip(found.joints, angles, strict=True):
                joint = model.joints[model.getJointId(name)]
                place[joint.idx_q : joint.idx_q + joint.nq] = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
            pin.framesForwardKinematics(model, data, place)
            base, end = (data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous for name in (found.base, found.flange))
            T = np.linalg.inv(base) @ end
            T[:3, 3] *= 1e3
            out.append(T)
        return np.array(out)

    return forward


def _mujoco(path: Path, found: ImportedRobot) -> Forward | None:
    mujoco: Any = import_module("mujoco")
    model = _compiled(mujoco, path)
    if model is None:
        return None
    data = mujoco.MjData(model)

    def place(name: str) -> np.ndarray | None:
        body, site = (mujoco.mj_name2id(model, kind, name) for kind in (mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_SITE))
        if body < 0 and site < 0:
            return None
        xpos, xmat, number = (data.xpos, data.xmat, body) if body >= 0 else (data.site_xpos, data.site_xmat, site)
        return se3.transform(xmat[number].reshape(3, 3).copy(), 1e3 * xpos[number])

    if place(found.base) is None or place(found.flange) is None or not all(found.joints):
        return None

    def forward(q: np.ndarray) -> np.ndarray:
        out = []
        for angles in q:
            for name, angle in zip(found.joints, angles, strict=True):
                data.joint(name).qpos[0] = angle
            mujoco.mj_kinematics(model, data)
            base, end = place(found.base), place(found.flange)
            assert base is not None
            assert end is not None
            out.append(np.linalg.inv(base) @ end)
        return np.array(out)

    return forward


def _compiled(mujoco: Any, path: Path) -> Any:
    """The model, with a tetrahedron for each mesh that is not there; None where MuJoCo does not read it."""
    assets: dict[str, bytes] = {}
    shapes: Counter[str] = Counter()
    for _ in range(MOST_MESHES):
        try:
            return mujoco.MjModel.from_xml_path(str(path.resolve()), assets)
        except ValueError as error:
            if (picture := PICTURE.search(str(error))) and (name := _asset(assets, picture[1])):
                shapes[name] += 1
                if shapes[name] == len(PICTURES):
                    return None
                assets[name] = _png(*PICTURES[shapes[name]])
                continue
            missing = OPENING.search(str(error))
            if missing is None or (name := missing[1] or missing[2]) in assets:
                return None
            kind = Path(name).suffix.lower()
            if kind not in (".obj", ".stl", ".png"):
                return None
            assets[name] = {".obj": TETRAHEDRON, ".stl": _stl(), ".png": _png(*PICTURES[0])}[kind]
    return None


def _stl() -> bytes:
    """The tetrahedron as a binary STL."""
    corners = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]], np.float32)
    out = bytes(80) + (4).to_bytes(4, "little")
    for a, b, c in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        out += bytes(12) + corners[[a, b, c]].tobytes() + bytes(2)
    return out


def _asset(assets: dict[str, bytes], file: str) -> str:
    """The name under which a file without its folder stands among the assets, '' where it does not."""
    return next((name for name in assets if Path(name).name == Path(file).name), "")


def _png(rows: int, columns: int) -> bytes:
    """A grey picture."""
    lines = rows * (b"\0" + 3 * columns * b"\x80")
    parts = (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(lines)), (b"IEND", b"")
    chunks = (struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


if __name__ == "__main__":
    sys.exit(main())
