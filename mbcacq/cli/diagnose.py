"""``mbcacq diagnose``: where simulation and recording differ, and which effects the model lacks."""

from __future__ import annotations

from pathlib import Path

import click

import mbcacq
from mbcacq.cli.declared import FILE, FOLDER, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line, put_to_use
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output import text
from mbcacq.effects import catalogue
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file
from mbcacq.recording.rrd import reader
from mbcacq.recording.run_folder import lock
from mbcacq.report.sources import run_folder
from mbcacq.workflow import calibrate, calibrate_with_found, load
from mbcacq.workflow import report as reports


@subcommand("diagnose")
def command(
    as_json: bool,
    data: tuple[Path, ...] = argument(RunPath(), required=True),
    out: Path | None = option("Write the diagnosis to this JSON file.", FILE),
    whole: bool = option("Print all figures, limits and notes, not one screen of them.", None, "--all"),
    report: Path | None = option("Write an HTML report with pictures.", FILE),
    rrd: Path | None = option("Write error arrows, or channels over time, before and after as a rerun recording.", FILE),
    workers: int | None = option("Processes that share the cross-validation (default: one for each processor core).", click.IntRange(1)),
    phases: tuple[str, ...] = option("Use poses of this phase only (repeatable) [default: all but verification].", None, "--phase"),
    hold: tuple[str, ...] = option("Keep this parameter at its nominal value, e.g. d_2 (repeatable).", metavar="NAME"),
    free: tuple[str, ...] = option("Free a parameter that would be held as redundant (repeatable).", metavar="NAME"),
    check: tuple[Path, ...] = option(
        "Try what was learnt on this recording of the same arm (repeatable): only its base, tool and stations are fitted.",
        RunPath(),
        metavar="OTHER",
    ),
    with_found: bool = option(
        "Then calibrate with what was found: result.json and bar.svg (the bar before and after calibration, after effects) go into the "
        "folder with-effects of the run, or of the current folder.",
        None,
        "--calibrate",
    ),
    place: str = option("With --check known: nothing is fitted.", ["fitted", "known"], default="fitted"),
    simulation: tuple[Path, ...] = option(
        "Compare with this instead of the built-in model: another simulator's set for the same poses or motion (one for each "
        "recording), or a model file that MuJoCo runs (MJCF, URDF).",
        click.Path(path_type=Path, exists=True),
        metavar="SIMULATED",
    ),
    propose: Path | None = option(
        "Search short formulas for unmodelled effects, and write the best as a package of an effect into DIR [default: proposed-effect].",
        FOLDER,
        flag_value="proposed-effect",
        metavar="[DIR]",
        is_flag=False,
    ),
    effect_files: tuple[Path, ...] = option(
        "Try the effect of this Python file, whose code is run, next to those of the catalogue (repeatable).",
        click.Path(path_type=Path, dir_okay=False, exists=True),
        "--effect-file",
        metavar="FILE.py",
    ),
    next_file: Path | None = option(
        "Write the poses that would decide most of what is left open as a plan, which runs: mbcacq run --extend RUN NEXT.yaml.",
        FILE,
        "--next",
        metavar="NEXT.yaml",
    ),
    minutes: float = option(
        "End the search after so many minutes. The verdict is then 'cannot tell', with the effects found so far.",
        click.FloatRange(0.01),
        default=OPTIONS.minutes,
    ),
    write_model: Path | None = option("Write the model file with what was found as MJCF.", FILE),
) -> Answer:
    """Diagnose DATA: a run folder ('latest': the newest in runs), an .rrd, an observation set; or trajectory sets of one robot, together.

    In the folder of a run the diagnosis is kept (diagnosis.json, diagnosis.rrd): mbcacq report and mbcacq view show it from then on.

    \b
    Examples:
      mbcacq diagnose latest --calibrate
      mbcacq diagnose latest --propose my-effect
      mbcacq diagnose latest --next next.yaml
      mbcacq diagnose ur5-tracker --report diagnosis.html --rrd diagnosis.rrd
      mbcacq diagnose ur10-tracker-a --check ur10-tracker-c --out diagnosis.json
      mbcacq diagnose motion1 motion2 --simulation arm.xml --write-model found.xml
    """
    options = mbcacq.CalibrationOptions(phases=phases or None, hold=hold, release=free)
    with StepProgress() as progress, catalogue.with_added(effect_files), reader.opened_once():
        progress("reading the recording")
        found = mbcacq.diagnose(
            data,
            progress=progress,
            workers=workers,
            options=options,
            check=check,
            place=place,
            simulation=simulation or None,
            propose=propose is not None,
            minutes=minutes,
        )
        if write_model is not None:
            write_matched_model(found, write_model)
        progress("writing the pictures")
        write_pictures(found, report, rrd)
        if found.poses is not None and found.observations is not None and load.is_run_folder(data[0]) and not simulation:
            found.keep(data[0])
        calibrated = with_effects(data, found, options) if with_found else []
        calibrated += [] if propose is None else proposed(found, propose)
        then = next_step(data, found, with_found)
        if next_file is not None:
            progress("choosing what to measure next")
            planned = planned_next(data, next_file)
            calibrated += planned
            if f"written to {next_file}" in planned:
                dry = "--dry-run" if found.observations is not None and found.observations.cell.simulated else "--arm"
                then = "measure them", command_line("run", next_file, "--extend", data[0], dry)
    if out is not None:
        write_file(out, found.to_json() + "\n")
    if as_json:
        for line in calibrated:
            echo(line, err=True)
    return Answer(found.to_json(), [found.in_words(calibrated=with_found, whole=whole), *calibrated], then)


def next_step(data: tuple[Path, ...], found: mbcacq.DiagnosisResult, with_found: bool) -> tuple[str, str]:
    """What to do after a diagnosis, and the command for it."""
    run = load.is_run_folder(data[0]) and len(data) == 1  # what is found in several recordings is kept in none of them
    if with_found:
        return put_to_use(data[0] / "with-effects" if run else Path("with-effects"))
    if found.poses is not None and text.is_to_be_calibrated_with(found.poses):
        return "calibrate with what was found", command_line("diagnose", *data, "--calibrate")
    if found.poses is not None and run:
        return "see it in the report", command_line("report", data[0])
    return "keep it", command_line("diagnose", *data, "--out", "diagnosis.json", "--report", "diagnosis.html")


def proposed(found: mbcacq.DiagnosisResult, folder: Path) -> list[str]:
    """Write the draft of an effect where a formula was found, and say how it is used."""
    if not found.proposals:
        return ["", "No formula is proposed, and nothing is written: there is none that predicts what was left out."]
    files = found.write_effect(folder)
    used = f"mbcacq diagnose DATA --effect-file {files[1]}"
    return ["", f"A draft of the effect is in {folder}: pip install {folder} adds it to the catalogue, {used} tries it at once."]


def planned_next(data: tuple[Path, ...], file: Path) -> list[str]:
    """Write the next measurements as a plan, and say what they are for."""
    if len(data) != 1:
        raise ConfigError("the next measurements extend one run; give one with --next")
    planned = mbcacq.next_plan(data[0], file)
    written = [f"written to {file}"] if planned.text else []
    return ["", *planned.sentences, *written]


def write_matched_model(found: mbcacq.DiagnosisResult, file: Path) -> None:
    """The model file of ``--simulation`` with what was found. Raises ConfigError where there was none."""
    if found.simulation is None:
        raise ConfigError("there is no model to write: --write-model needs a model file in --simulation")
    found.simulation.write(file)


def write_pictures(found: mbcacq.DiagnosisResult, report: Path | None, rrd: Path | None) -> None:
    """The page and the recording that were asked for."""
    if report is not None:
        found.write_html(report)
    if rrd is not None:
        found.write_rrd(rrd)


def with_effects(data: tuple[Path, ...], found: mbcacq.DiagnosisResult, options: mbcacq.CalibrationOptions) -> list[str]:
    """Calibrate with what was found, write the result, and say what came of it."""
    run = data[0] if load.is_run_folder(data[0]) else None
    result = calibrate_with_found.calibrate_with_found(found, options, calibrate.limit_of(run) if run is not None else None)
    files = result.write((run or Path()) / run_folder.WITH_EFFECTS)
    if run is not None:
        assert found.observations is not None, "what was calibrated has observations"
        files.append(reports.write_report(run))  # whose first page is about the best model that the run has
        with lock.write_lock(run, "diagnose"):
            files.append(result.show_in_viewer(run, found.observations))
    return ["", result.text, *(str(file) for file in files)]
