"""``mbcacq plan``: make a plan, look at it, check it. No socket is opened."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.plan_copy import copy
from mbcacq.cli.plan_design import design
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.plan_program import program
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import console as terminal_console
from mbcacq.cli.terminal import echo
from mbcacq.errors import ExitCode


@click.group("plan")
def command() -> None:
    """Make, copy, show, check or design a plan, write it as a robot program; without opening a socket."""


command.add_command(design)
command.add_command(program)
command.add_command(copy)


@command.command("new")
@click.option("--robot", help="One of the tool's by name (kr6_r900_2, ur10e, panda ...) or a robot file.")
@click.option("--scanner", help="gocator-3210, or a YAML file with scanner and hand_eye.")
@click.option("--artefact", help="One of the tool's by name (mbc-8) or an artefact file.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("plan.yaml"), show_default=True, help="The plan to write.")
@click.option("--driver", help="Driver of the robot [default: kuka_rsi for a KUKA KR, else simulated, for dry runs].")
@click.option("--stations", type=click.IntRange(2, 12), default=6, show_default=True, help="Places of the artefact to calibrate at.")
@click.option("--poses", "count", type=click.IntRange(6, 400), default=36, show_default=True, help="Calibration poses at them.")
@click.option("--seed", default=0, show_default=True, help="Seed of the random views to choose from.")
@click.option("--force", is_flag=True, help="Replace the file if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def new(
    robot: str | None,
    scanner: str | None,
    artefact: str | None,
    out: Path,
    driver: str | None,
    stations: int,
    count: int,
    seed: int,
    force: bool,
    as_json: bool,
) -> None:
    """Make a plan from nothing: stations and views that this arm reaches, the scanner sees and the calibration learns from.

    \b
    Example:
      mbcacq plan new --robot kr6_r900_2 --scanner gocator-3210 --artefact mbc-8
    """
    from mbcacq.design.new_plan import NewPlanOptions
    from mbcacq.errors import ConfigError
    from mbcacq.model import shipped
    from mbcacq.workflow.new_plan import new_plan

    wanted: dict[str, str] = {}
    for kind, given in (("robots", robot), ("scanners", scanner), ("artefacts", artefact)):
        choices = ", ".join(p.stem for p in sorted((shipped.folder() / kind).glob("*.yaml")))
        if given is None and not sys.stdin.isatty():
            raise ConfigError(f"the {kind[:-1]} is not given; add --{kind[:-1]} with a file or one of the tool's own: {choices}")
        wanted[kind] = given or click.prompt(f"{kind[:-1]} ({choices}, or a file)", err=True)
    options = NewPlanOptions(driver, stations, count, seed)
    with StepProgress() as steps:
        made = new_plan(wanted["robots"], wanted["scanners"], wanted["artefacts"], out, options, force=force, progress=steps.printed)
    if as_json:
        places = [str(s.id) for s in made.plan.stations]
        echo(json.dumps({"format": "mbcacq-new-plan/1", "plan": str(out), "name": made.plan.name, "stations": places}))
    else:
        say_next("see what it can and cannot determine", command_line("plan", "check", out))


@command.command("show")
@click.argument("plan", type=PlanPath())
@click.option("--rrd", type=click.Path(path_type=Path), help="Also draw it: the arm on its way, as a recording for rerun.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def show(plan: Path, rrd: Path | None, as_json: bool) -> None:
    """Walk through PLAN: every pose with its joint angles, and the time it all takes."""
    from mbcacq.plan import expand, load
    from mbcacq.plan.routing import find_paths
    from mbcacq.plan.summary import summary

    loaded = load(plan)
    with StepProgress() as steps:
        steps.begin("looking for postures that reach every pose")
        poses = expand(loaded)
        steps.begin("looking for free paths between them")
        routes = find_paths(loaded, poses)
        content = summary(loaded, poses, routes)
        if rrd is not None:
            from mbcacq.recording.rrd.plan_recording import write_plan_recording

            steps.begin("drawing the arm on its path")
            write_plan_recording(loaded, poses, routes[0], [p["start_s"] for p in content["poses"]], rrd)
    if as_json:
        echo(json.dumps(content))
        return
    _print_steps(content)
    _print_poses(content)
    echo(_time_sentence(content))
    say_next("find what is wrong with it", command_line("plan", "check", plan))


@command.command("check")
@click.argument("plan", type=PlanPath())
@click.option("--quick", is_flag=True, help="Check only what would stop a run, not what the plan can see.")
@click.option("--fix", is_flag=True, help="Write the plan with stations moved into reach, and without views that stay out of reach.")
@click.option("--all", "every", is_flag=True, help="One line for each finding, instead of one for each kind and step.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def check(plan: Path, quick: bool, fix: bool, every: bool, as_json: bool) -> None:
    """Find what is wrong with PLAN (reach, limits, singularities, view, collisions), and what it can and cannot see.

    Errors end with exit code 2.
    """
    from mbcacq.acquisition.device_check import device_findings
    from mbcacq.design.plan_findings import identifiability_findings, reach_findings, sentences
    from mbcacq.plan import load
    from mbcacq.plan.expansion import expand_reachable
    from mbcacq.plan.feasibility import check
    from mbcacq.plan.findings import merged
    from mbcacq.plan.routing import find_paths
    from mbcacq.plan.summary import summary

    loaded = load(plan)
    if fix:
        loaded = _fixed(loaded, plan)
    with StepProgress() as steps:
        steps.begin("looking for postures that reach every pose")
        poses, _ = expand_reachable(loaded)
        steps.begin("looking for free paths between them")
        routes = find_paths(loaded, poses)
        findings, content = [*device_findings(loaded), *check(loaded, poses, routes)], summary(loaded, poses, routes)
        steps.begin("computing what the poses determine")
        more, accuracy, effects = ([], None, None) if quick else identifiability_findings(loaded, poses, content, routes)
        findings += more
        findings += reach_findings(loaded)
    errors = sum(f.level == "error" for f in findings)
    if as_json:
        content |= {"findings": [f.to_dict() for f in findings], "errors": errors}
        content |= {"prospect": accuracy and accuracy.to_dict(), "visibility": effects and effects.to_dict()}
        echo(json.dumps(content))
    else:
        colour = {"error": "red", "warning": "yellow", "info": "cyan"}
        for f in findings if every else merged(findings):
            echo(f" {f}", label=(f.level, colour[f.level]), color=_colour())
        for line in sentences(accuracy, effects) if accuracy and effects else []:
            echo(line)
        echo(_time_sentence(content))
        for axis in content["axes"]:
            echo(_axis_sentence(axis))
        warnings = sum(f.level == "warning" for f in findings)
        echo(f"{errors} error{'s' * (errors != 1)}, {warnings} warning{'s' * (warnings != 1)}")
        if not errors:
            say_next("try it without hardware", command_line("run", plan, "--dry-run"))
        elif any(f.code == "move-station" for f in findings):
            say_next("let the stations be moved into reach", command_line("plan", "check", plan, "--fix"))
        else:
            say_next("correct the plan, then look again", command_line("plan", "check", plan))
    if errors:
        sys.exit(ExitCode.USAGE)


def _fixed(loaded: Any, plan: Path) -> Any:
    """The plan with what is out of reach repaired, written where it was."""
    from mbcacq.design.station_repair import repaired

    fixed, said = repaired(loaded)
    if said:
        from mbcacq.files.atomic_write import write_file

        write_file(plan, fixed.text)
    for sentence in said or ["nothing is out of reach that --fix can change"]:
        echo(sentence, err=True)
    return fixed


def _colour() -> bool | None:
    import os

    return False if os.environ.get("NO_COLOR") else None


def _print_steps(content: dict[str, Any]) -> None:
    from rich.table import Table

    table = Table(title=content["name"], title_justify="left")
    for name in ("step", "phase", "stations", "poses", "exposures"):
        table.add_column(name, justify="right" if name in ("poses", "exposures") else "left")
    for step in content["steps"]:
        table.add_row(step["name"], step["phase"], " ".join(step["stations"]), str(step["poses"]), str(step["exposures"]))
    terminal_console().print(table)


def _print_poses(content: dict[str, Any]) -> None:
    """Plain lines, below the name of each step: a table fitted to a narrow terminal would cut the angles."""
    poses = content["poses"]
    if not poses:
        return
    station = max(len("station"), *(len(p["station"]) for p in poses))
    wide, digits = (8, 2) if len(poses[0]["q_deg"]) <= 6 else (7, 1)
    axes = "".join(f"{axis['name']:>{wide}}" for axis in content["axes"])
    echo(f"{'pose':>4} {'at s':>5}  {'station':{station}} {'balls':>5}{axes}  via")
    for before, p in zip([None, *poses], poses, strict=False):
        if before is None or p["step"] != before["step"]:
            echo(f"{p['step']}:")
        angles = "".join(f"{a:{wide}.{digits}f}" for a in p["q_deg"])
        echo(f"{p['pose']:4} {p['start_s']:5.0f}  {p['station']:{station}} {len(p['balls']):5}{angles}  {p['waypoints'] or ''}".rstrip())


def _time_sentence(content: dict[str, Any]) -> str:
    t = content["duration"]
    moved = f", and the artefact is moved {t['station_changes']} times (not counted)" if t["station_changes"] else ""
    parts = f"{t['motion_s']:.0f} s of motion, {t['settle_s']:.0f} s of settling, {t['exposure_s']:.0f} s of exposures"
    return f"{len(content['poses'])} poses; about {t['total_s'] / 60:.1f} min: {parts}{moved}"


def _axis_sentence(axis: dict[str, Any]) -> str:
    units = {"speed": "/s", "acceleration": "/s²", "jerk": "/s³"}
    figures = (f"{axis[what]:.0f} of {axis[f'{what}_limit']:.0f} {axis['unit']}{per}" for what, per in units.items())
    return f"{axis['name']}: at most {', '.join(figures)}"
