"""``mbcacq apply``: a scan taken at a pose, brought into the base frame with the calibrated cell."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mbcacq.cli.next_step import say_next
from mbcacq.cli.run_path import RunPath, judge_first
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.quantities import K, uncertainty

if TYPE_CHECKING:
    from mbcacq.spheres.cloud_file import CloudFile


@click.command("apply")
@click.argument("result", type=RunPath())
@click.argument("cloud", type=click.Path(path_type=Path))
@click.option("--joints", required=True, metavar="Q1,Q2,...", help="Joint angles of the exposure, in °, as the controller reports them.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="PLY to write [default: CLOUD with _base before its ending].")
@click.option(
    "--unit",
    type=click.Choice(["mm", "m", "cm", "um", "in", "inch"]),
    help="Unit of the cloud's coordinates [default: as its header says, or mm].",
)
@click.option("--force", is_flag=True, help="Replace a file that is already there.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(result: Path, cloud: Path, joints: str, out: Path | None, unit: str | None, force: bool, as_json: bool) -> None:
    """Bring CLOUD (PLY or PCD, scanner frame) into the robot's base frame with RESULT (a result.json, or a run folder that holds one).

    Colours, intensities and all other properties of the points stay. The command prints how well the points are placed: expanded
    uncertainties (k = 2) from the calibrated parameters and from the joints' repeatability. The noise of single points is not included.

    Example: mbcacq apply runs/today --joints=0,-90,90,0,30,0 scan.ply
    """
    import numpy as np

    from mbcacq.calibration.result_io import with_warnings
    from mbcacq.errors import ConfigError
    from mbcacq.exports.clouds import write_cloud
    from mbcacq.exports.result_json import load_result
    from mbcacq.exports.scan_correction import place_scan
    from mbcacq.spheres.cloud_file import in_mm, read_cloud_file
    from mbcacq.workflow.load import unsealed_note

    out = out or cloud.with_name(f"{cloud.stem}_base.ply")
    if out.exists() and not force:
        raise ConfigError(f"{out} exists; give another --out, or --force to replace it")
    try:
        q = np.radians([float(part) for part in joints.replace(";", ",").split(",")])
    except ValueError:
        raise ConfigError(f"--joints '{joints}' is not a list of numbers; give degrees with commas, such as 0,-90,90,0,30,0") from None
    known = load_result(result)
    with StepProgress() as steps:
        steps.begin("bringing the scan into the base frame")
        found = read_cloud_file(cloud)
        moved, placed = place_scan(known, q, in_mm(cloud, found, unit))
        changed = write_cloud(out, moved, found.properties, placed.T_base_scanner)
    notes = _notes(found, unit, known, changed)
    if as_json:
        echo(
            json.dumps(
                {
                    "format": "mbcacq-apply/1",
                    "output": str(out),
                    "points": len(moved),
                    "notes": notes,
                    **({"simulated": True} if known.get("simulated") else {}),
                    "T_base_scanner": placed.T_base_scanner.tolist(),
                    "sigma_mm": placed.total_mm.tolist(),
                    "sigma_parameters_mm": placed.parameters_mm.tolist(),
                    "sigma_repeatability_mm": placed.repeatability_mm.tolist(),
                    "sigma_3d_mm": placed.rms_mm,
                    "sigma_3d_worst_mm": placed.worst_mm,
                }
            )
        )
        return
    for sentence in [*with_warnings(known), *unsealed_note(result)]:
        echo(f"*** {sentence} ***", err=True)
    for note in notes:
        echo(f"note: {note}", err=True)
    x, y, z = (uncertainty(1e3 * K * sigma) for sigma in placed.total_mm)
    middle, worst = (uncertainty(1e3 * K * sigma) for sigma in (placed.rms_mm, placed.worst_mm))
    echo(f"{out}: {len(moved)} points in the base frame")
    echo(f"placed within U = {x}, {y}, {z} µm along X, Y, Z (k = 2), 3D {middle} µm in the middle, {worst} µm at worst")
    say_next(*judge_first(result))


def _notes(cloud: CloudFile, unit: str | None, result: Mapping[str, Any], changed: Sequence[str]) -> list[str]:
    """What was decided about the cloud without being asked. unit: as it was said; changed: properties that PLY has no type for."""
    import numpy as np

    from mbcacq.files.stated_unit import in_words
    from mbcacq.spheres.cloud_file import looks_small

    notes = []
    if cloud.missing:
        notes.append(f"{cloud.missing} places of the cloud hold no point and were left out")
    if not unit and cloud.unit not in ("", "mm"):
        notes.append(f"the cloud is read in {in_words(cloud.unit)}, as its header says")
    if cloud.viewpoint:
        notes.append("its VIEWPOINT is not applied: the points are taken as they stand, in the scanner frame")
    balls = np.array([ball["centre_mm"] for ball in result.get("balls", ())], dtype=float).reshape(-1, 3)
    if not (unit or cloud.unit) and (small := looks_small(cloud.points, balls)):
        notes.append(small)
    if changed:
        notes.append(f"PLY has no type for {', '.join(changed)}; written as double")
    return notes
