"""``mbcacq run``: the whole job, from the plan to the before/after table."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mbcacq.errors import Aborted, CalibrationError, ConfigError

if TYPE_CHECKING:
    from mbcacq.plan import LoadedPlan, PlannedPose
    from mbcacq.recording.run_folder.progress import Progress


@click.command("run")
@click.argument("plan", type=click.Path(path_type=Path))
@click.option("--dry-run", is_flag=True, help="Against the fake cell, which speaks the devices' protocols on this computer.")
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [default: runs/TIME_NAME].")
@click.option("--resume", type=click.Path(path_type=Path), help="Go on with this run folder: poses already measured are skipped.")
@click.option("--live", is_flag=True, help="Serve the recording to a rerun viewer on 127.0.0.1 while it grows.")
@click.option("--again", is_flag=True, help="With --resume: measure stations anew that were measured in part (the artefact was touched).")
@click.option("--arm", is_flag=True, help="A real arm may move, once its speed, workspace and first target are confirmed by typing.")
@click.option("--step", is_flag=True, help="Wait for a key before each pose.")
@click.option("--yes", is_flag=True, help="Answer the positioner's prompts with yes (a dry run does).")
@click.option("--seed", default=0, show_default=True, help="Seed of the fake cell.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout.")
def command(
    plan: Path,
    dry_run: bool,
    out: Path | None,
    resume: Path | None,
    live: bool,
    again: bool,
    arm: bool,
    step: bool,
    yes: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Execute PLAN, record it, calibrate the cell and show how good it became.

    \b
    Examples:
      mbcacq run plans/kuka.yaml --dry-run
      mbcacq run my-cell.yaml --arm --step
      mbcacq run my-cell.yaml --arm --resume runs/2026-11-21T10-00-00_my-cell
    """
    from mbcacq.cli.arming import ask_before_motion
    from mbcacq.cli.progress import RunProgress
    from mbcacq.cli.stepping import KeyPause
    from mbcacq.devices import load_driver
    from mbcacq.plan import expand, load, refuse_errors
    from mbcacq.workflow import run

    end_in_order_when_told()
    if resume and out:
        raise ConfigError("--resume and --out exclude each other: a resumed run goes on in its own folder")
    pause = KeyPause() if step else None
    loaded = load(plan)
    poses = expand(loaded)
    refuse_errors(loaded, poses)
    cell = f"the fake cell of seed {seed}" if dry_run else "the plan's own devices"
    before = run.resume_folder(resume, loaded, cell) if resume else run.fresh()
    for sentence in before.repairs:
        click.echo(sentence, err=True)
    if resume and not again:
        again = moved_meanwhile(loaded, poses, before, asked=not (dry_run or yes))
    done = run.without_partial_stations(poses, before) if again else before.done
    if all(pose.number in done for pose in poses):
        click.echo(f"all {len(poses)} poses were measured already; nothing moves", err=True)
        folder = resume
    else:
        acquisition = run.plan_run(loaded, poses, done, before.part, cell)
        if not dry_run:
            ask_before_motion(loaded, [p for p in poses if p.number not in done], acquisition.sweep(), arm)
        folder = acquisition.folder = resume or run.new_run_folder(out, plan.stem)
        fake = load_driver("fakes", "cell")(loaded, poses, realtime=False, seed=seed) if dry_run else nullcontext()
        with fake:
            overrides = fake.overrides() if dry_run else {}
            if yes and loaded.plan.positioner.driver == "manual":
                overrides = {**overrides, "positioner": {**overrides.get("positioner", {}), "assume_yes": True}}
            if not_merged := acquisition.execute(overrides, [RunProgress(quiet=as_json)], live=live, told=tell_viewer, pause=pause):
                click.echo(not_merged, err=True)
    limit = loaded.plan.accept.sphere_spacing_error_mm
    result = run.evaluate(folder, limit)
    if as_json:
        click.echo(json.dumps(result))
    else:
        from mbcacq.cli.calibrate import print_result

        print_result(result)
    worst = (result.get("verification") or {}).get("after", {}).get("max_mm")
    if limit is not None and worst is not None and worst > limit:
        raise CalibrationError(
            f"the largest sphere spacing error is {worst:.3f} mm, above the plan's limit of {limit:g} mm; see {result['files']['report']}"
        )


def moved_meanwhile(loaded: LoadedPlan, poses: Sequence[PlannedPose], before: Progress, asked: bool) -> bool:
    """Whether an artefact was touched at a station that is measured in part: its poses then belong to two places. Asks the operator who
    moves it; a positioner, and --yes, are taken to have left it alone (what moved far is seen in the first scan)."""
    left = {p.station for p in poses if p.number not in before.done}
    partial = sorted(left & set(before.stations))
    if not partial or not asked or loaded.plan.positioner.driver != "manual" or not sys.stdin.isatty():
        return False
    return not click.confirm(f"Station {partial[0]} was measured in part. Does its artefact stand exactly as then, untouched?", err=True)


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
