"""``mbcacq calibrate``: identify the cell from a recording and say how far to trust the result."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mbcacq.cli.next_step import command_line, put_to_use, say_next
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import console as terminal_console
from mbcacq.cli.terminal import echo
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS

if TYPE_CHECKING:
    from mbcacq.estimation.options import ArmPrior


@click.command("calibrate")
@click.argument("data", nargs=-1, required=True, type=RunPath())
@click.option(
    "--method",
    type=click.Choice(["ml", "paper"]),
    default="ml",
    show_default=True,
    help="ml: everything at once by maximum likelihood; paper: the published method, stage by stage.",
)
@click.option(
    "--pairs",
    type=click.Choice(["one", "four", "all"]),
    default="four",
    show_default=True,
    help="Paper's method, pairs of balls that are used: one, as printed; all pairs of its four balls; all pairs of all balls.",
)
@click.option("--held-out", type=click.Choice(["station", "random", "block"]), help="Also refit without some poses and predict those.")
@click.option("--held-out-size", type=click.IntRange(min=1), help="Poses held out of each random fit [default: 30 %, at most 300].")
@click.option("--fits", type=click.IntRange(min=1), help="Number of random or block fits [default: 3 random, 5 blocks].")
@click.option("--seed", default=0, show_default=True, help="Seed of the random choice.")
@click.option("--phase", "phases", multiple=True, help="Use poses of this phase only (repeatable) [default: all but verification].")
@click.option("--hold", multiple=True, metavar="NAME", help="Keep this parameter at its nominal value, e.g. d_2 (repeatable).")
@click.option(
    "--free", "--release", "release", multiple=True, metavar="NAME", help="Free a parameter that would be held as redundant (repeatable)."
)
@click.option("--hand-eye-only", is_flag=True, help="Take the arm as nominal; identify hand-eye and stations only.")
@click.option("--geometry-alone", is_flag=True, help="Free links and no smooth errors beside them; what the model lacks counts as noise.")
@click.option(
    "--noise",
    type=click.Choice(["auto", "given", "estimate"]),
    default="auto",
    show_default=True,
    help="auto: stated scanner noise is a guess to start from; given: it is exact; estimate: it is ignored.",
)
@click.option("--keep-outliers", is_flag=True, help="Do not reject gross outliers.")
@click.option("--even-if-undetermined", is_flag=True, help="Hold what the poses leave undetermined instead of refusing.")
@click.option(
    "--effects",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="DIAGNOSIS.json",
    help="Fit the effects of this diagnosis (or result.json) with everything else (repeatable).",
)
@click.option("--hold-effects", is_flag=True, help="With --effects: keep their coefficients as they are.")
@click.option(
    "--prior",
    type=click.Path(path_type=Path),
    metavar="FLEET",
    help="Take the errors of other arms of this type as prior: a folder or table of mbcacq fleet.",
)
@click.option("--map", "with_map", is_flag=True, help="Add the expected accuracy over the workspace to the result, on a grid of 250 mm.")
@click.option("--l-curve", type=click.Path(path_type=Path, dir_okay=False), help="Paper's method: draw its L-curve into this HTML file.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the result to this JSON file.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout.")
def command(
    data: tuple[Path, ...],
    method: str,
    pairs: str,
    held_out: str | None,
    held_out_size: int | None,
    fits: int | None,
    seed: int,
    phases: tuple[str, ...],
    hold: tuple[str, ...],
    release: tuple[str, ...],
    hand_eye_only: bool,
    geometry_alone: bool,
    noise: str,
    keep_outliers: bool,
    even_if_undetermined: bool,
    effects: tuple[Path, ...],
    hold_effects: bool,
    prior: Path | None,
    with_map: bool,
    l_curve: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Calibrate the cell from DATA: a run folder ('latest': the newest in runs), a recording (.rrd) or an observation set.

    Several recordings of one arm are calibrated together: arm and effects are shared; base, tool, stations, artefacts and noise are not.

    \b
    Examples:
      mbcacq calibrate latest
      mbcacq calibrate runs/monday runs/friday --effects found.json --out arm.json
      mbcacq calibrate ur5-tracker --held-out random --held-out-size 300
      mbcacq calibrate latest --effects diagnosis.json --out result.json
    """
    import mbcacq
    from mbcacq.calibration.result_io import of_flange_poses
    from mbcacq.errors import ConfigError
    from mbcacq.workflow.calibrate import HeldOutOptions, calibration_content, draw_l_curve, joint_content

    options = mbcacq.CalibrationOptions(
        method=method,
        pairs=pairs,
        phases=phases or None,
        kinematics=not hand_eye_only,
        discrepancy=not geometry_alone,
        random_links=not geometry_alone,
        hold=hold,
        release=release,
        noise=noise,
        robust=not keep_outliers,
        refuse=not even_if_undetermined,
        priors=learnt_priors(prior),
    )
    split = HeldOutOptions(held_out, held_out_size, fits, seed) if held_out else None
    if hold_effects and not effects:
        raise ConfigError("--hold-effects is of use with --effects DIAGNOSIS.json only")
    known = {"effects": list(effects), "hold_effects": hold_effects} if effects else {}
    first, *others = data
    if others and (split or with_map or l_curve):
        raise ConfigError("--held-out, --map and --l-curve are of one recording; give one, or leave them out")
    with StepProgress() as progress:
        progress.begin("reading the recording and calibrating")
        if others:
            result = joint_content(data, options, **known)
        else:
            result = calibration_content(first, options, held_out=split, with_map=with_map, **known)
    if l_curve:
        draw_l_curve(result, l_curve)
    if out:
        from mbcacq.files.atomic_write import write_file
        from mbcacq.model.json_text import sealed_text

        write_file(out, sealed_text(result))
        result["files"] = {"result": str(out)}
    if as_json:
        echo(json.dumps(result))
    elif others:
        print_joint_result(result)
    else:
        print_result(result)
    if not as_json:
        say_next(
            *next_step(
                data,
                effects,
                out,
                joints=not (of_flange_poses(result) or result.get("length_instrument")),
                poses=result.get("fit", {}).get("poses"),
            )
        )


def next_step(
    data: tuple[Path, ...], effects: tuple[Path, ...], out: Path | None, joints: bool = True, poses: int | None = None
) -> tuple[str, str]:
    """What to do after a calibration, and the command for it: ask for what the model lacks, unless that was done. joints: their angles
    are known; no effect can be asked for with poses of the flange."""
    if not joints:
        return "hold the usual methods for the hand-eye transformation against it", command_line("compare", data[0])
    if not effects and (poses is None or poses >= DIAGNOSIS.fewest_poses):
        return "ask whether the model lacks an effect", command_line("diagnose", *data)
    if out is None:
        given = [word for file in effects for word in ("--effects", file)]
        return "keep the result", command_line("calibrate", *data, *given, "--out", "result.json")
    return put_to_use(out)


def learnt_priors(fleet: Path | None) -> tuple[ArmPrior, ...]:
    """What a fleet says about the next arm; nothing where there is none."""
    if fleet is None:
        return ()
    from mbcacq.fleet.arm_prior import read_priors

    return read_priors(fleet)


def print_joint_result(joint: dict[str, Any]) -> None:
    """Show a joint result: the arm and its effects once, then what belongs to each recording."""
    from mbcacq.cli import tables

    console = terminal_console(highlight=False, soft_wrap=True)
    first = joint["recordings"][0]["result"]
    if tables.identifies_arm(first):
        console.print(tables.parameters(first))
    for line in [*tables.effects(first), *tables.day_to_day(joint)]:
        console.print(line, markup=False)
    for number, one in enumerate(joint["recordings"], 1):
        console.print(f"\nRecording {number}: {one['name']}", markup=False)
        shown = {key: value for key, value in one["result"].items() if key != "effects"}
        print_result(shown, arm=False)
    for name, path in (joint.get("files") or {}).items():
        console.print(f"{name}: {path}", soft_wrap=True)


def print_result(result: dict[str, Any], *, arm: bool = True) -> None:
    """Show a result (content of result.json, with 'verification', 'held_out', 'gaps', 'files' where there are) as tables on stdout, with
    the table of the arm or without."""

    from mbcacq.calibration.result_io import caveats
    from mbcacq.cli import tables

    console = terminal_console(highlight=False, soft_wrap=True)
    for sentence in caveats(result):
        console.print(f"*** {sentence} ***", markup=False)
    if arm and tables.identifies_arm(result):
        console.print(tables.parameters(result))
    for table in (*tables.fixed_scanners(result), tables.hand_eye(result)):
        console.print(table)
    fit = (
        tables.effects,
        tables.fit,
        tables.images,
        tables.length_instrument,
        tables.clock,
        tables.scan_scale,
        tables.stages,
        tables.remarks,
        tables.arm_improved,
    )
    for line in (line for lines in fit for line in lines(result)):
        console.print(line)
    if result.get("verification"):
        console.print(tables.verification(result["verification"]))
        for line in [*tables.figures(result["verification"]), *tables.judgement(result)]:
            console.print(line, markup=False)
    if result.get("held_out"):
        console.print(tables.held_out(result["held_out"]))
    for gap in result.get("gaps") or ():
        console.print(f"About the recording: {gap}", markup=False)
    for name, path in (result.get("files") or {}).items():
        console.print(f"{name}: {path}", soft_wrap=True)
