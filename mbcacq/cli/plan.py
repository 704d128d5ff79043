"""``mbcacq plan``: make a plan, look at it, check it. No socket is opened."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from rich.table import Table

import mbcacq
from mbcacq import plan as plans
from mbcacq.acquisition import device_check
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_copy import copy
from mbcacq.cli.plan_design import design
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.plan_program import program
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo, titled_table
from mbcacq.design import plan_findings, station_repair
from mbcacq.errors import ConfigError, ExitCode
from mbcacq.files import atomic_write
from mbcacq.model import shipped
from mbcacq.recording.rrd import plan_recording

LONGEST_TRACK_MM = 1e5
COLOURS = {"error": "red", "warning": "yellow", "info": "cyan"}


@click.group("plan")
def command() -> None:
    """Make, copy, show, check or design a plan, write it as a robot program; without opening a socket."""


command.add_command(design)
command.add_command(program)
command.add_command(copy)


@subcommand("new", command)
def new(
    robot: str | None = option("One of the tool's by name (kr6_r900_2, ur10e, panda ...) or a robot file."),
    scanner: str | None = option("gocator-3210, or a YAML file with scanner and hand_eye."),
    artefact: str | None = option("One of the tool's by name (mbc-8) or an artefact file."),
    out: Path = option("The plan to write.", default=Path("plan.yaml")),
    driver: str | None = option("Driver of the robot [default: kuka_rsi for a KUKA KR, else simulated, for dry runs]."),
    stations: int = option("Places of the artefact to calibrate at.", click.IntRange(2, 12), default=6),
    count: int = option("Calibration poses at them.", click.IntRange(6, 400), "--poses", default=36),
    seed: int = option("Seed of the random views to choose from.", default=0),
    track: str | None = option("Ends of a track under the arm, along its x axis, in mm: 0:3000."),
    force: bool = option("Replace the file if it exists."),
) -> Answer:
    """Make a plan from nothing: stations and views that this arm reaches, the scanner sees and the calibration learns from.

    \b
    Example:
      mbcacq plan new --robot kr6_r900_2 --scanner gocator-3210 --artefact mbc-8
    """
    wanted: dict[str, str] = {}
    for kind, given in (("robots", robot), ("scanners", scanner), ("artefacts", artefact)):
        choices = ", ".join(p.stem for p in sorted((shipped.folder() / kind).glob("*.yaml")))
        if given is None and not sys.stdin.isatty():
            raise ConfigError(f"the {kind[:-1]} is not given; add --{kind[:-1]} with a file or one of the tool's own: {choices}")
        wanted[kind] = given or click.prompt(f"{kind[:-1]} ({choices}, or a file)", err=True)
    options = mbcacq.NewPlanOptions(driver, stations, count, seed, None if track is None else _ends(track))
    with StepProgress() as steps:
        made = mbcacq.new_plan(wanted["robots"], wanted["scanners"], wanted["artefacts"], out, options, force=force, progress=steps.printed)
    places = [str(s.id) for s in made.plan.stations]
    document = {"format": "mbcacq-new-plan/1", "plan": str(out), "name": made.plan.name, "stations": places}
    return Answer(document, then=("see what it can and cannot determine", command_line("plan", "check", out)))


def _ends(text: str) -> tuple[float, float]:
    """The ends of a track. Raises click.BadParameter."""
    try:
        low, high = (float(end) for end in text.split(":"))
    except ValueError:
        low = high = 0.0
    if not low < high or high - low > LONGEST_TRACK_MM:
        raise click.BadParameter(f"'{text}' is no track; give its two ends in mm, such as 0:3000", param_hint="--track")
    return low, high


@subcommand("show", command)
def show(
    plan: Path = argument(PlanPath()), rrd: Path | None = option("Also draw it: the arm on its way, as a recording for rerun.")
) -> Answer:
    """Walk through PLAN: every pose with its joint angles, and the time it all takes."""
    from mbcacq.plan.routing import find_paths
    from mbcacq.plan.summary import summary

    loaded = plans.load(plan)
    with StepProgress("looking for postures that reach every pose") as steps:
        poses = plans.expand(loaded)
        steps.begin("looking for free paths between them")
        routes = find_paths(loaded, poses)
        content = summary(loaded, poses, routes)
        if rrd is not None:
            steps.begin("drawing the arm on its path")
            plan_recording.write_plan_recording(loaded, poses, routes[0], [p["start_s"] for p in content["poses"]], rrd)
    lines = [_steps(content), *_poses(content), _time_sentence(content)]
    return Answer(content, lines, ("find what is wrong with it", command_line("plan", "check", plan)))


@subcommand("check", command)
def check(
    plan: Path = argument(PlanPath()),
    quick: bool = option("Check only what would stop a run, not what the plan can see."),
    fix: bool = option("Write the plan with stations moved into reach, and without views that stay out of reach."),
    every: bool = option("One line for each finding, instead of one for each kind and step.", None, "--all"),
) -> Answer:
    """Find what is wrong with PLAN (reach, limits, singularities, view, collisions), and what it can and cannot see.

    Errors end with exit code 2.
    """
    from mbcacq.plan.expansion import expand_reachable
    from mbcacq.plan.feasibility import check
    from mbcacq.plan.findings import merged
    from mbcacq.plan.routing import find_paths
    from mbcacq.plan.summary import summary

    loaded = plans.load(plan)
    if fix:
        loaded = _fixed(loaded, plan)
    with StepProgress("looking for postures that reach every pose") as steps:
        poses, _ = expand_reachable(loaded)
        steps.begin("looking for free paths between them")
        routes = find_paths(loaded, poses)
        findings, content = [*device_check.device_findings(loaded), *check(loaded, poses, routes)], summary(loaded, poses, routes)
        steps.begin("computing what the poses determine")
        more, accuracy, effects = ([], None, None) if quick else plan_findings.identifiability_findings(loaded, poses, content, routes)
        findings += more
        findings += plan_findings.reach_findings(loaded)
    errors = sum(f.level == "error" for f in findings)
    content |= {"findings": [f.to_dict() for f in findings], "errors": errors}
    content |= {"prospect": accuracy and accuracy.to_dict(), "visibility": effects and effects.to_dict()}
    lines: list[Any] = [(f" {f}", (f.level, COLOURS[f.level])) for f in (findings if every else merged(findings))]
    lines += plan_findings.sentences(accuracy, effects) if accuracy and effects else []
    lines += [_time_sentence(content), *map(_axis_sentence, content["axes"])]
    warnings = sum(f.level == "warning" for f in findings)
    lines.append(f"{errors} error{'s' * (errors != 1)}, {warnings} warning{'s' * (warnings != 1)}")
    if not errors:
        then = "try it without hardware", command_line("run", plan, "--dry-run")
    elif any(f.code == "move-station" for f in findings):
        then = "let the stations be moved into reach", command_line("plan", "check", plan, "--fix")
    else:
        then = "correct the plan, then look again", command_line("plan", "check", plan)
    return Answer(content, lines, then, end=lambda: sys.exit(ExitCode.USAGE) if errors else None)


def _fixed(loaded: Any, plan: Path) -> Any:
    """The plan with what is out of reach repaired, written where it was."""
    fixed, said = station_repair.repaired(loaded)
    if said:
        atomic_write.write_file(plan, fixed.text)
    for sentence in said or ["nothing is out of reach that --fix can change"]:
        echo(sentence, err=True)
    return fixed


def _steps(content: dict[str, Any]) -> Table:
    words = ("step", "phase", "stations")
    table = titled_table(content["name"], *words, "poses", "exposures", left=words)
    for step in content["steps"]:
        table.add_row(step["name"], step["phase"], " ".join(step["stations"]), str(step["poses"]), str(step["exposures"]))
    return table


def _poses(content: dict[str, Any]) -> Iterator[str]:
    """Plain lines, below the name of each step: a table fitted to a narrow terminal would cut the angles."""
    poses = content["poses"]
    if not poses:
        return
    station = max(len("station"), *(len(p["station"]) for p in poses))
    wide, digits = (8, 2) if len(poses[0]["q_deg"]) <= 6 else (7, 1)
    axes = "".join(f"{axis['name']:>{wide}}" for axis in content["axes"])
    yield f"{'pose':>4} {'at s':>5}  {'station':{station}} {'balls':>5}{axes}  via"
    for before, p in zip([None, *poses], poses, strict=False):
        if before is None or p["step"] != before["step"]:
            yield f"{p['step']}:"
        angles = "".join(f"{a:{wide}.{digits}f}" for a in p["q_deg"])
        yield f"{p['pose']:4} {p['start_s']:5.0f}  {p['station']:{station}} {len(p['balls']):5}{angles}  {p['waypoints'] or ''}".rstrip()


def _time_sentence(content: dict[str, Any]) -> str:
    t = content["duration"]
    moved = f", and the artefact is moved {t['station_changes']} times (not counted)" if t["station_changes"] else ""
    parts = f"{t['motion_s']:.0f} s of motion, {t['settle_s']:.0f} s of settling, {t['exposure_s']:.0f} s of exposures"
    return f"{len(content['poses'])} poses; about {t['total_s'] / 60:.1f} min: {parts}{moved}"


def _axis_sentence(axis: dict[str, Any]) -> str:
    units = {"speed": "/s", "acceleration": "/s²", "jerk": "/s³"}
    figures = (f"{axis[what]:.0f} of {axis[f'{what}_limit']:.0f} {axis['unit']}{per}" for what, per in units.items())
    return f"{axis['name']}: at most {', '.join(figures)}"
