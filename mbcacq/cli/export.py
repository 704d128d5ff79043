"""``mbcacq export``: recordings and results in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import mbcacq
from mbcacq.calibration import result_io
from mbcacq.cli.declared import FILE, FOLDER, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.run_path import RunPath, folder_of, judge_first
from mbcacq.cli.step_progress import StepProgress
from mbcacq.exports import marks, mount, result_json
from mbcacq.model import cell
from mbcacq.quantities import K, uncertainty
from mbcacq.workflow import export, load


@subcommand("export")
def command(
    run: Path = argument(RunPath()),
    observations: Path | None = option("Write an observation set (YAML, CSV) there.", FOLDER),
    scans: bool = option("With --observations: the raw clouds as well (scans/POSE.ply, first exposure of each pose)."),
    trajectory: Path | None = option("Write the controller cycles as a trajectory set.", FOLDER),
    force: bool = option("Replace what is already there."),
    simulated_anyway: bool = option("With --results: also write the calibration of a dry run."),
    results: Path | None = option(
        "Write the calibration of RUN (a folder with result.json, or that file) into this folder: JSON, CSV, KUKA, ROS.", FOLDER
    ),
    only: tuple[str, ...] = option(
        "With --results: these formats alone (result, csv, kuka, ros, mjcf, urdf, those of further packages).", metavar="FORMAT"
    ),
    tool: int = option("With --results: number of TOOL_DATA.", click.IntRange(1, 128), default=1),
    tool_name: str = option("With --results: TOOL_NAME.", default="mbcacq scanner"),
    config_dat: Path | None = option("With --results: a $config.dat to write a unified diff against."),
    urdf: Path | None = option("With --results: a URDF or xacro to write a calibrated copy of."),
    joints: tuple[str, ...] = option("With --urdf: its moving joints, base first (default: all revolute ones).", None, "--joint"),
    flange_frame: str = option("With --results: name of the flange in ROS.", default="tool0"),
    scanner_frame: str = option("With --results: name of the scanner in ROS.", default="scanner_frame"),
    artefact: str | None = option(
        "RUN is a certificate (CSV, YAML, DMIS output): write it as the artefact file ID.yaml here, or where --output says.", metavar="ID"
    ),
    output: Path | None = option("With --artefact: the file to write.", FILE),
) -> Answer:
    """Write RUN (a run folder, a .rrd file or an observation set) in the formats of other programs."""
    targets = mbcacq.Targets(
        only=only,
        tool=tool,
        tool_name=tool_name,
        config_dat=config_dat,
        urdf=urdf,
        joints=joints,
        flange_frame=flange_frame,
        scanner_frame=scanner_frame,
    )
    wanted = {"observations": observations, "trajectory": trajectory, "results": results}
    written = []
    with StepProgress("reading and writing"):
        if artefact is None or any(wanted.values()):
            written += mbcacq.export(run, scans=scans, targets=targets, force=force, simulated_anyway=simulated_anyway, **wanted)
        if artefact is not None:
            written.append(export.export_artefact(run, artefact, output, force=force))
    shown = [_line_of(one) for one in written]
    notes = [note for one in written for note in one.get("notes", ())]
    then = next_step(run, observations, results, trajectory, None if artefact is None else written[-1]["file"])
    return Answer({"format": "mbcacq-export/1", "written": written}, shown, then, _caveats(run, results, written), notes)


def _line_of(one: dict[str, Any]) -> str:
    """A file that was written, with what is in it."""
    figures = {key: value for key, value in one.items() if key not in ("file", "simulated", "notes")}
    more = ", ".join(f"U = {uncertainty(K * v)} mm (k = 2)" if k == "uncertainty_mm" else f"{v} {k}" for k, v in figures.items())
    return one["file"] + (f": {more}" if more else "")


def next_step(
    run: Path, observations: Path | None, results: Path | None, trajectory: Path | None = None, artefact: str | None = None
) -> tuple[str, str]:
    """What to do after an export, and the command for it. artefact: its file, where RUN is a certificate."""
    if observations is not None:
        return "calibrate with the observation set", command_line("calibrate", observations)
    if results is not None:
        arm = results / "arm.mjcf.xml"
        if folder_of(run) is None and arm.exists():
            what = "plan with the calibrated arm; in place of 30 °/s, which is slow, put the speed of its data sheet"
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
    if results is not None:
        result = result_json.load_result(run)
        about = (f"KUKA, ROS and URDF files: {sentence}" for sentence in marks.geometry_alone(result))
        return [*result_io.with_warnings(result), *load.unsealed_note(run), *mount.remark(result), *about]
    return [cell.SIMULATED] if any(one.get("simulated") for one in written) else []
