"""``mbcacq apply``: a scan taken at a pose, brought into the base frame with the calibrated cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbcacq.calibration import result_io
from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.run_path import RunPath, judge_first
from mbcacq.cli.step_progress import StepProgress
from mbcacq.errors import ConfigError
from mbcacq.exports import clouds as written_clouds
from mbcacq.exports import result_json, scan_correction
from mbcacq.files import stated_unit
from mbcacq.quantities import K, uncertainty
from mbcacq.spheres import cloud_file
from mbcacq.workflow import arm_positions, load


@subcommand("apply")
def command(
    result: Path = argument(RunPath()),
    cloud: Path = argument(),
    joints: str | None = option("Joint angles of the exposure, in °, as the controller reports them.", metavar="Q1,Q2,..."),
    flange: str | None = option(
        "Pose of the flange at the exposure, in mm and °, as the controller reports it; a rotation vector in rad.", metavar="X,Y,Z,..."
    ),
    orientation: str | None = option(
        "Convention of the flange's orientation: kuka, fanuc, abb, ur, .., or axes such as ZYX.", metavar="MAKER"
    ),
    poses: Path | None = option("Table of joint angles or poses of the flange, with a row for each cloud of the folder CLOUD.", FILE),
    out: Path | None = option("PLY to write [default: CLOUD with _base before its ending]; of a folder, a folder."),
    unit: str | None = option(
        "Unit of the clouds' coordinates [default: as their header says, or mm].", ["mm", "m", "cm", "um", "in", "inch"]
    ),
    force: bool = option("Replace files that are already there."),
) -> Answer:
    """Bring CLOUD (PLY or PCD, scanner frame) into the robot's base frame with RESULT (a result.json, or a run folder that holds one).

    CLOUD may be a folder of clouds, with a table of the arm's positions (--poses). Colours, intensities and all other properties of the
    points stay. The command prints how well the points are placed: expanded uncertainties (k = 2) from the calibrated parameters and from
    the repeatability of joints or poses. The noise of single points is not included.

    Example: mbcacq apply runs/today --joints=0,-90,90,0,30,0 scan.ply

    Example: mbcacq apply result.json clouds --poses flange.csv --orientation kuka
    """
    if sum(given is not None for given in (joints, flange, poses)) != 1:
        raise ConfigError("say where the arm stood, one of --joints, --flange, and --poses TABLE for a folder of clouds")
    if (poses is not None) != cloud.is_dir():
        raise ConfigError(f"{cloud} {'is no folder' if poses else 'is a folder'}; --poses TABLE goes with a folder of clouds")
    known, matched = result_json.load_result(result), ""
    if poses is not None:
        clouds = arm_positions.clouds_in(cloud, (".ply", ".pcd"))
        positions, matched = arm_positions.positions_in(poses, known, clouds, orientation)
    else:
        clouds = [cloud]
        positions = [arm_positions.typed_flange(flange or "", orientation) if joints is None else arm_positions.typed_joints(joints, known)]
    outputs = _outputs(clouds, out or cloud.with_name(f"{cloud.name}_base"), force) if poses else _output(cloud, out, force)
    placed = []
    with StepProgress() as steps:
        for one, position, output in zip(clouds, positions, outputs, strict=True):
            steps.begin("bringing the scan into the base frame" if poses is None else f"bringing {one.name} into the base frame")
            placed.append(_placed(known, one, position, output, unit))
    marked = {"format": "mbcacq-apply/1", **({"simulated": True} if known.get("simulated") else {})}
    document = {**marked, **placed[0]} if poses is None else {**marked, "matched": matched, "clouds": placed}
    notes = dict.fromkeys([note for one in placed for note in one["notes"]] + ([matched] if matched else []))
    warnings = [*result_io.with_warnings(known), *load.unsealed_note(result)]
    return Answer(document, (line for one in placed for line in _lines_of(one)), judge_first(result), warnings, notes)


def _lines_of(one: Mapping[str, Any]) -> list[str]:
    """What is said about one cloud that was written."""
    x, y, z = (uncertainty(1e3 * K * sigma) for sigma in one["sigma_mm"])
    middle, worst = (uncertainty(1e3 * K * one[name]) for name in ("sigma_3d_mm", "sigma_3d_worst_mm"))
    placed = f"placed within U = {x}, {y}, {z} µm along X, Y, Z (k = 2), 3D {middle} µm in the middle, {worst} µm at worst"
    return [f"{one['output']}: {one['points']} points in the base frame", placed]


def _output(cloud: Path, out: Path | None, force: bool) -> list[Path]:
    """The file of one cloud. Raises ConfigError where it is there and ``force`` is not given."""
    made = out or cloud.with_name(f"{cloud.stem}_base.ply")
    load.refuse_existing(made, force, f"{made} exists; give another --out, or --force to replace it")
    return [made]


def _outputs(clouds: Sequence[Path], folder: Path, force: bool) -> list[Path]:
    """The files of several clouds in a folder, which is made. Raises ConfigError where two are one, or one is there."""
    made = [path for one in clouds for path in _output(one, folder / f"{one.stem}_base.ply", force)]
    if twice := next((path for path in made if made.count(path) > 1), None):
        raise ConfigError(f"two clouds would become {twice}; rename one")
    folder.mkdir(parents=True, exist_ok=True)
    return made


def _placed(known: Mapping[str, Any], cloud: Path, position: arm_positions.ArmPosition, out: Path, unit: str | None) -> dict[str, Any]:
    """Write one cloud in the base frame; what was written, and how well it is placed."""
    found = cloud_file.read_cloud_file(cloud)
    moved, placed = scan_correction.place_scan(known, position.q, cloud_file.in_mm(cloud, found, unit), flange=position.flange)
    changed = written_clouds.write_cloud(out, moved, found.properties, placed.T_base_scanner)
    return {
        "output": str(out),
        "points": len(moved),
        "notes": _notes(found, unit, known, changed),
        "T_base_scanner": placed.T_base_scanner.tolist(),
        "sigma_mm": placed.total_mm.tolist(),
        "sigma_parameters_mm": placed.parameters_mm.tolist(),
        "sigma_repeatability_mm": placed.repeatability_mm.tolist(),
        "sigma_3d_mm": placed.rms_mm,
        "sigma_3d_worst_mm": placed.worst_mm,
    }


def _notes(cloud: cloud_file.CloudFile, unit: str | None, result: Mapping[str, Any], changed: Sequence[str]) -> list[str]:
    """What was decided about the cloud without being asked. unit: as it was said; changed: properties that PLY has no type for."""
    import numpy as np

    notes = []
    if cloud.missing:
        notes.append(f"{cloud.missing} places of the cloud hold no point and were left out")
    if not unit and cloud.unit not in ("", "mm"):
        notes.append(f"the cloud is read in {stated_unit.in_words(cloud.unit)}, as its header says")
    if cloud.viewpoint:
        notes.append("its VIEWPOINT is not applied: the points are taken as they stand, in the scanner frame")
    balls = np.array([ball["centre_mm"] for ball in result.get("balls", ())], dtype=float).reshape(-1, 3)
    if not (unit or cloud.unit) and (small := cloud_file.looks_small(cloud.points, balls)):
        notes.append(small)
    if changed:
        notes.append(f"PLY has no type for {', '.join(changed)}; written as double")
    return notes
