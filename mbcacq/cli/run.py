"""``mbcacq run``: the whole job, from the plan to the before/after table."""

from __future__ import annotations

import ipaddress
import json
import signal
import sys
from contextlib import nullcontext
from pathlib import Path

import click

from mbcacq.errors import Aborted, CalibrationError, ConfigError


@click.command("run")
@click.argument("plan", type=click.Path(path_type=Path))
@click.option("--dry-run", is_flag=True, help="Against the fake cell, which speaks the devices' protocols on this computer.")
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [default: runs/TIME_NAME].")
@click.option("--resume", type=click.Path(path_type=Path), help="Go on with this run folder: poses already measured are skipped.")
@click.option("--live", is_flag=True, help="Serve the recording to a rerun viewer on 127.0.0.1 while it grows.")
@click.option("--arm", is_flag=True, help="Allow a real arm to move without asking on the terminal.")
@click.option("--yes", is_flag=True, help="Answer the positioner's prompts with yes (a dry run does).")
@click.option("--seed", default=0, show_default=True, help="Seed of the fake cell.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout.")
def command(plan: Path, dry_run: bool, out: Path | None, resume: Path | None, live: bool, arm: bool, yes: bool, seed: int,
            as_json: bool) -> None:
    """Execute PLAN, record it, calibrate the cell and show how good it became."""
    from mbcacq import pipeline
    from mbcacq.cli.progress import RunProgress
    from mbcacq.devices import load_driver
    from mbcacq.plan import expand, load, path, refuse_errors
    from mbcacq.plan.route import way_home

    end_in_order_when_told()
    loaded = load(plan)
    poses = expand(loaded)
    refuse_errors(loaded, poses)
    if not dry_run:
        ask_before_motion(loaded.plan.robot.options, loaded.cell.robot.name, len(poses), arm)
    if resume and out:
        raise ConfigError("--resume and --out exclude each other: a resumed run goes on in its own folder")
    folder, done, parts = pipeline.resume_folder(resume, loaded) if resume else (pipeline.new_run_folder(out, plan.stem), frozenset(), 0)
    acquisition = pipeline.Acquisition(loaded, poses, path(loaded, poses, done), way_home(loaded, poses[-1]), folder, parts)
    fake = load_driver("fakes", "cell")(loaded, poses, realtime=False, seed=seed) if dry_run else nullcontext()
    with fake:
        overrides = fake.overrides() if dry_run else {}
        if yes and loaded.plan.positioner.driver == "manual":
            overrides = {**overrides, "positioner": {**overrides.get("positioner", {}), "assume_yes": True}}
        acquisition.execute(overrides, [RunProgress(quiet=as_json)], live=live, done=done, told=tell_viewer)
    limit = loaded.plan.accept.sphere_spacing_error_mm
    result = pipeline.evaluate(folder, limit)
    if as_json:
        click.echo(json.dumps(result))
    else:
        from mbcacq.cli.calibrate import print_result

        print_result(result)
    worst = (result.get("verification") or {}).get("after", {}).get("max_mm")
    if limit is not None and worst is not None and worst > limit:
        raise CalibrationError(f"the largest sphere spacing error is {worst:.3f} mm, above the plan's limit of {limit:g} mm; "
                               f"see {result['files']['report']}")


def end_in_order_when_told() -> None:
    """A closed terminal and ``kill`` end the run as Ctrl-C does: arm at rest, recording complete, nothing left behind."""

    def end(number: int, frame: object) -> None:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)  # once is enough; a second one must not disturb the closing
        raise Aborted(f"the run was ended by {signal.Signals(number).name}")

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    for number in numbers:
        if signal.getsignal(number) == signal.SIG_DFL:  # nohup stays nohup
            signal.signal(number, end)


def tell_viewer(url: str) -> None:
    click.echo(f"watch it live: rerun {url}", err=True)


def ask_before_motion(options: dict, robot: str, n_poses: int, arm: bool) -> None:
    """The last question before a real arm moves, and before its drives are switched on. A controller that can only be on this computer is a
    fake and is not asked about: its driver listens, by its option ``bind``, on a loopback address."""
    if arm or _loopback(str(options.get("bind", ""))) and "eki" not in options:
        return
    if not sys.stdin.isatty():
        raise ConfigError(f"this would move {robot}; without a terminal to ask on, say so with --arm")
    click.echo(f"{robot} will move: to its home position, then through {n_poses} poses. "
               "Is the cell clear and the stop button at hand?", err=True)
    try:
        allowed = click.confirm("Move the robot?", err=True)
    except click.Abort:
        allowed = False
    if not allowed:
        raise Aborted("the operator did not allow the robot to move")


def _loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"
