"""Public robot descriptions, imported and compared with pinocchio (URDF, xacro) and MuJoCo (MJCF) where these read them.

    pip install pin                                        # pinocchio; without it URDF files are imported and not compared
    python benchmarks/robot_files.py DIR [DIR ...] [--all] [--package NAME=DIR]

Takes every .urdf, .xacro, .mjcf and .xml with <robot> or <mujoco> below the folders. Prints what was refused and why, and per kind: files,
imported and right (20 random vectors of joint angles within 1e-6 mm of the reference), imported and not compared, wrong, refused because
they hold no arm of at least three axes or several arms, refused although they hold one.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
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
NO_ARM = re.compile(r"no moving joints|chains of joints end in|fewer than two|mujocoinclude|defines macros only|free; an arm|begins with <")
Forward = Callable[[np.ndarray], np.ndarray]


def main() -> int:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--all", action="store_true", help="also print the files that are right")
    parser.add_argument("--package", action="append", default=[], metavar="NAME=DIR")
    options = parser.parse_args()
    packages = {name: Path(folder) for name, _, folder in (pair.partition("=") for pair in options.package)}
    counted: dict[str, Counter[str]] = {}
    for path in (p for folder in options.folders for p in sorted(folder.rglob("*")) if p.suffix.lower() in KINDS and p.is_file()):
        if not re.search(rb"<(robot|mujoco)", path.read_bytes()[:100_000]):
            continue
        outcome, sentence = judged(path, packages)
        counted.setdefault(KINDS[path.suffix.lower()], Counter())[outcome] += 1
        if options.all or outcome not in ("right", "no single arm"):
            print(f"{outcome}: {path}: {sentence}")
    outcomes = ("right", "not compared", "wrong", "no single arm", "refused")
    print("\n| kind | files | " + " | ".join(outcomes) + " |\n|---|" + "---|" * (len(outcomes) + 1))
    for kind, found in sorted(counted.items()):
        print(f"| {kind} | {found.total()} | " + " | ".join(str(found[o]) for o in outcomes) + " |")
    return 1 if any(found["wrong"] for found in counted.values()) else 0


def judged(path: Path, packages: dict[str, Path]) -> tuple[str, str]:
    """What came of one file, and a sentence about it."""
    try:
        found = import_robot(path, packages=packages)
    except MbcacqError as error:
        sentence = str(error).removeprefix(f"{path}: ")
        return ("no single arm" if NO_ARM.search(sentence) else "refused"), sentence
    about = f"{len(found.joints)} axes, {found.base} to {found.flange}"
    is_mjcf = KINDS[path.suffix.lower()] == "MJCF" and b"<mujoco" in path.read_bytes()
    reference = _mujoco(path, found) if is_mjcf else _pinocchio(path, packages, found)
    if reference is None:
        return "not compared", about
    arm = RobotSpec.model_validate(yaml.safe_load(found.text)).model()
    low, high = np.clip(arm.limits, -np.pi, np.pi).T
    q = np.random.default_rng(0).uniform(low, high, (VECTORS, arm.n))
    ours, theirs = found.T_given_base @ arm.chain.flange(q) @ found.T_flange_given, reference(q)
    miss_mm = float(np.abs(ours[:, :3, 3] - theirs[:, :3, 3]).max())
    miss_rad = float(np.abs(ours[:, :3, :3] - theirs[:, :3, :3]).max())
    right = miss_mm < CLOSE_MM and miss_rad < CLOSE_RAD
    return ("right" if right else "wrong"), f"{about}, differs by {miss_mm:.1e} mm, {miss_rad:.1e} rad"


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
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError:  # its meshes are not there
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


if __name__ == "__main__":
    sys.exit(main())
