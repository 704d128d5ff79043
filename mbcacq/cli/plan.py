"""``mbcacq plan``: look at a plan, check it, design a better one. No socket is opened."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from mbcacq.errors import ExitCode


@click.group("plan")
def command() -> None:
    """Show, check or design a plan, without opening a socket."""


@command.command("show")
@click.argument("plan", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def show(plan: Path, as_json: bool) -> None:
    """Walk through PLAN: every pose with its joint angles, and the time it all takes."""
    from mbcacq.plan import expand, load
    from mbcacq.plan.summary import summary

    loaded = load(plan)
    content = summary(loaded, expand(loaded))
    if as_json:
        click.echo(json.dumps(content))
        return
    _print_steps(content)
    _print_poses(content)
    click.echo(_time_sentence(content))


@command.command("check")
@click.argument("plan", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@click.option("--all", "every", is_flag=True, help="One line a finding, instead of one a kind and step.")
def check(plan: Path, as_json: bool, every: bool) -> None:
    """Find what is wrong with PLAN: reach, joint limits, singularities, view, collisions. Errors end with exit code 2."""
    from mbcacq.plan import load
    from mbcacq.plan.checks import check
    from mbcacq.plan.expansion import expand_reachable
    from mbcacq.plan.findings import merged
    from mbcacq.plan.summary import summary

    loaded = load(plan)
    poses, _ = expand_reachable(loaded)
    findings = check(loaded, poses)
    errors = sum(f.level == "error" for f in findings)
    if as_json:
        click.echo(json.dumps({**summary(loaded, poses), "findings": [f.to_dict() for f in findings], "errors": errors}))
    else:
        colour = {"error": "red", "warning": "yellow", "info": "cyan"}
        for f in findings if every else merged(findings):
            click.echo(f"{click.style(f.level, fg=colour[f.level])} {f}", color=_colour())
        click.echo(_time_sentence(summary(loaded, poses)))
        click.echo(f"{errors} errors, {sum(f.level == 'warning' for f in findings)} warnings")
    if errors:
        sys.exit(ExitCode.USAGE)


def _colour() -> bool | None:
    import os

    return False if os.environ.get("NO_COLOR") else None


def _print_steps(content: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=content["name"], title_justify="left")
    for name in ("step", "phase", "stations", "poses", "exposures"):
        table.add_column(name, justify="right" if name in ("poses", "exposures") else "left")
    for step in content["steps"]:
        table.add_row(step["name"], step["phase"], " ".join(step["stations"]), str(step["poses"]), str(step["exposures"]))
    Console().print(table)


def _print_poses(content: dict[str, Any]) -> None:
    """Plain lines: a table fitted to a narrow terminal would cut the angles."""
    poses = content["poses"]
    if not poses:
        return
    wide = {key: max(len(key), *(len(p[key]) for p in poses)) for key in ("step", "station")}
    axes = "".join(f"{f'A{i + 1}':>8}" for i in range(len(poses[0]["q_deg"])))
    click.echo(f"{'pose':>4} {'at s':>5}  {'step':{wide['step']}}  {'station':{wide['station']}} {'balls':>5}{axes}  via")
    for p in poses:
        angles = "".join(f"{a:8.2f}" for a in p["q_deg"])
        where = f"{p['step']:{wide['step']}}  {p['station']:{wide['station']}}"
        click.echo(f"{p['pose']:4} {p['start_s']:5.0f}  {where} {len(p['balls']):5}{angles}  {p['waypoints'] or ''}".rstrip())


def _time_sentence(content: dict[str, Any]) -> str:
    t = content["duration"]
    moved = f", and the artefact is moved {t['station_changes']} times (not counted)" if t["station_changes"] else ""
    parts = f"{t['motion_s']:.0f} s of motion, {t['settle_s']:.0f} s of settling, {t['exposure_s']:.0f} s of exposures"
    return f"{len(content['poses'])} poses; about {t['total_s'] / 60:.1f} min: {parts}{moved}"
