"""``mbcacq export``: recordings and results in the formats of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.run_path import RunPath, folder_of, judge_first
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.quantities import K, uncertainty


@click.command("export")
@click.argument("run", type=RunPath())
@click.option("--observations", type=click.Path(path_type=Path, file_okay=False), help="Write an observation set (YAML, CSV) there.")
@click.option("--scans", is_flag=True, help="With --observations: the raw clouds as well (scans/POSE.ply, first exposure of each pose).")
@click.option("--trajectory", type=click.Path(path_type=Path, file_okay=False), help="Write the controller cycles as a trajectory set.")
@click.option("--force", is_flag=True, help="Replace what is already there.")
@click.option("--simulated-anyway", is_flag=True, help="With --results: also write the calibration of a dry run.")
@click.option(
    "--results",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write the calibration of RUN (a folder with result.json, or that file) into this folder: JSON, CSV, KUKA, ROS.",
)
@click.option(
    "--only",
    metavar="FORMAT",
    multiple=True,
    help="With --results: these formats alone (result, csv, kuka, ros, mjcf, urdf, those of further packages).",
)
@click.option("--tool", type=click.IntRange(1, 128), default=1, show_default=True, help="With --results: number of TOOL_DATA.")
@click.option("--tool-name", default="mbcacq scanner", show_default=True, help="With --results: TOOL_NAME.")
@click.option("--config-dat", type=click.Path(path_type=Path), help="With --results: a $config.dat to write a unified diff against.")
@click.option("--urdf", type=click.Path(path_type=Path), help="With --results: a URDF or xacro to write a calibrated copy of.")
@click.option("--joint", "joints", multiple=True, help="With --urdf: its moving joints, base first (default: all revolute ones).")
@click.option("--flange-frame", default="tool0", show_default=True, help="With --results: name of the flange in ROS.")
@click.option("--scanner-frame", default="scanner_frame", show_default=True, help="With --results: name of the scanner in ROS.")
@click.option(
    "--artefact",
    metavar="ID",
    help="RUN is a certificate (CSV, YAML, DMIS output): write it as the artefact file ID.yaml here, or where --output says.",
)
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), help="With --artefact: the file to write.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as one JSON object on stdout.")
def command(
    run: Path,
    observations: Path | None,
    scans: bool,
    trajectory: Path | None,
    force: bool,
    simulated_anyway: bool,
    as_json: bool,
    **others: Any,
) -> None:
    """Write RUN (a run folder, a .rrd file or an observation set) in the formats of other programs."""
    import mbcacq
    from mbcacq.workflow.export import export_artefact

    results, artefact, output = (others.pop(name) for name in ("results", "artefact", "output"))
    wanted = {"observations": observations, "trajectory": trajectory, "results": results}
    written = []
    with StepProgress() as steps:
        steps.begin("reading and writing")
        if artefact is None or any(wanted.values()):
            written += mbcacq.export(
                run, scans=scans, targets=mbcacq.Targets(**others), force=force, simulated_anyway=simulated_anyway, **wanted
            )
        if artefact is not None:
            written.append(export_artefact(run, artefact, output, force=force))
    if as_json:
        echo(json.dumps({"format": "mbcacq-export/1", "written": written}))
        return
    for sentence in _caveats(run, results, written):
        echo(f"*** {sentence} ***", err=True)
    for one in written:
        one.pop("simulated", None)
        for note in one.pop("notes", ()):
            echo(f"note: {note}", err=True)
        more = ", ".join(
            f"U = {uncertainty(K * v)} mm (k = 2)" if k == "uncertainty_mm" else f"{v} {k}" for k, v in one.items() if k != "file"
        )
        echo(one["file"] + (f": {more}" if more else ""))
    say_next(*next_step(run, observations, results, trajectory, None if artefact is None else written[-1]["file"]))


def next_step(
    run: Path, observations: Path | None, results: Path | None, trajectory: Path | None = None, artefact: str | None = None
) -> tuple[str, str]:
    """What to do after an export, and the command for it. artefact: its file, where RUN is a certificate."""
    if observations is not None:
        return "calibrate with the observation set", command_line("calibrate", observations)
    if results is not None:
        arm = results / "arm.mjcf.xml"
        if folder_of(run) is None and arm.exists():
            what = "describe plans by the calibrated arm (30 °/s is slow: put in the speed of its data sheet)"
            return what, command_line("robot", "import", arm, "--speed", 30, "--out", "calibrated-arm.yaml")
        return judge_first(run)
    if trajectory is not None:
        return "ask which effects the motion shows", command_line("diagnose", trajectory)
    if artefact is not None:
        what = "make a plan with it, here for an arm and a scanner of the tool's own"
        devices = ("--robot", "kr6_r900_2", "--scanner", "gocator-3210")
        return what, command_line("plan", "new", *devices, "--artefact", artefact)
    return "see the whole run", command_line("report" if run.is_dir() else "view", run)


def _caveats(run: Path, results: Path | None, written: list[dict[str, Any]]) -> list[str]:
    """What must be known before the files are used."""
    from mbcacq.calibration.result_io import with_warnings
    from mbcacq.exports.result_json import load_result
    from mbcacq.model.cell import SIMULATED
    from mbcacq.workflow.load import unsealed_note

    if results is not None:
        from mbcacq.exports.marks import geometry_alone
        from mbcacq.exports.mount import remark

        result = load_result(run)
        about = (f"KUKA, ROS and URDF files: {sentence}" for sentence in geometry_alone(result))
        return [*with_warnings(result), *unsealed_note(run), *remark(result), *about]
    return [SIMULATED] if any(one.get("simulated") for one in written) else []
