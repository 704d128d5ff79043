"""``mbcacq calibrate``: identify the cell from a recording and say how far to trust the result."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mbcacq
from mbcacq.calibration import result_io
from mbcacq.cli import tables
from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line, put_to_use
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS
from mbcacq.errors import ConfigError
from mbcacq.estimation import options as arm_options
from mbcacq.files import atomic_write
from mbcacq.fleet import arm_prior
from mbcacq.model import json_text
from mbcacq.workflow import calibrate

if TYPE_CHECKING:
    from rich.table import Table


@subcommand("calibrate")
def command(
    data: tuple[Path, ...] = argument(RunPath(), required=True),
    method: str = option(
        "ml: everything at once by maximum likelihood; paper: the published method, stage by stage.", ["ml", "paper"], default="ml"
    ),
    pairs: str = option(
        "Paper's method, pairs of balls that are used: one, as printed; all pairs of its four balls; all pairs of all balls.",
        ["one", "four", "all"],
        default="four",
    ),
    held_out: str | None = option("Also refit without some poses and predict those.", ["station", "random", "block"]),
    held_out_size: int | None = option("Poses held out of each random fit [default: 30 %, at most 300].", click.IntRange(min=1)),
    fits: int | None = option("Number of random or block fits [default: 3 random, 5 blocks].", click.IntRange(min=1)),
    seed: int = option("Seed of the random choice.", default=0),
    phases: tuple[str, ...] = option("Use poses of this phase only (repeatable) [default: all but verification].", None, "--phase"),
    hold: tuple[str, ...] = option("Keep this parameter at its nominal value, e.g. d_2 (repeatable).", metavar="NAME"),
    release: tuple[str, ...] = option(
        "Free a parameter that would be held as redundant (repeatable).", None, "--free", "--release", metavar="NAME"
    ),
    hand_eye_only: bool = option("Take the arm as nominal; identify hand-eye and stations only."),
    geometry_alone: bool = option("Free links and no smooth errors beside them; what the model lacks counts as noise."),
    noise: str = option(
        "auto: stated scanner noise is a guess to start from; given: it is exact; estimate: it is ignored.",
        ["auto", "given", "estimate"],
        default="auto",
    ),
    keep_outliers: bool = option("Do not reject gross outliers."),
    even_if_undetermined: bool = option("Hold what the poses leave undetermined instead of refusing."),
    effects: tuple[Path, ...] = option(
        "Fit the effects of this diagnosis (or result.json) with everything else (repeatable).", metavar="DIAGNOSIS.json"
    ),
    hold_effects: bool = option("With --effects: keep their coefficients as they are."),
    prior: Path | None = option("Take the errors of other arms of this type as prior: a folder or table of mbcacq fleet.", metavar="FLEET"),
    with_map: bool = option("Add the expected accuracy over the workspace to the result, on a grid of 250 mm.", None, "--map"),
    l_curve: Path | None = option("Paper's method: draw its L-curve into this HTML file.", FILE),
    out: Path | None = option("Write the result to this JSON file.", FILE),
) -> Answer:
    """Calibrate the cell from DATA: a run folder ('latest': the newest in runs), a recording (.rrd) or an observation set.

    Several recordings of one arm are calibrated together: arm and effects are shared; base, tool, stations, artefacts and noise are not.

    \b
    Examples:
      mbcacq calibrate latest
      mbcacq calibrate runs/monday runs/friday --effects found.json --out arm.json
      mbcacq calibrate ur5-tracker --held-out random --held-out-size 300
      mbcacq calibrate latest --effects diagnosis.json --out result.json
    """
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
    split = {"split": held_out, "size": held_out_size, "fits": fits, "seed": seed} if held_out else None
    if hold_effects and not effects:
        raise ConfigError("--hold-effects is of use with --effects DIAGNOSIS.json only")
    known = {"effects": list(effects), "hold_effects": hold_effects} if effects else {}
    first, *others = data
    if others and (split or with_map or l_curve):
        raise ConfigError("--held-out, --map and --l-curve are of one recording; give one, or leave them out")
    with StepProgress("reading the recording and calibrating"):
        if others:
            result = calibrate.joint_content(data, options, **known)
        else:
            result = calibrate.calibration_content(first, options, held_out=split, with_map=with_map, **known)
    if l_curve:
        calibrate.draw_l_curve(result, l_curve)
    if out:
        atomic_write.write_file(out, json_text.sealed_text(result))
        result["files"] = {"result": str(out)}
    if result_io.of_flange_poses(result):
        then = next_of_flange_poses(data, out)
    elif result.get("length_instrument"):
        then = "hold the usual methods against it", command_line("compare", data[0])
    else:
        then = next_step(data, effects, out, result.get("fit", {}).get("poses"))
    return Answer(result, lines_of_joint(result) if others else lines_of(result), then, wide=True)


def answer_of_run(done: mbcacq.RunResult) -> Answer:
    """The result of a run. It ends with the exit code of a limit that is exceeded."""
    return Answer(done.to_dict(), lines_of(done.to_dict()), done.next_step, wide=True, end=done.refuse_beyond_limit)


def next_of_flange_poses(data: tuple[Path, ...], out: Path | None) -> tuple[str, str]:
    """What to do after a calibration from poses of a flange, and the command for it: no effect can be asked for."""
    if out is None:
        return "keep the result", command_line("calibrate", *data, "--hand-eye-only", "--out", "result.json")
    return "judge it by further poses", command_line("verify", out, "OTHER")


def next_step(data: tuple[Path, ...], effects: tuple[Path, ...], out: Path | None, poses: int | None = None) -> tuple[str, str]:
    """What to do after a calibration, and the command for it: ask for what the model lacks, unless that was done."""
    if not effects and (poses is None or poses >= DIAGNOSIS.fewest_poses):
        return "ask whether the model lacks an effect", command_line("diagnose", *data)
    if out is None:
        given = [word for file in effects for word in ("--effects", file)]
        return "keep the result", command_line("calibrate", *data, *given, "--out", "result.json")
    return put_to_use(out)


def learnt_priors(fleet: Path | None) -> tuple[arm_options.ArmPrior, ...]:
    """What a fleet says about the next arm; nothing where there is none."""
    if fleet is None:
        return ()
    return arm_prior.read_priors(fleet)


def lines_of_joint(joint: dict[str, Any]) -> Iterator[str | Table]:
    """A joint result: the arm and its effects once, then what belongs to each recording."""
    first = joint["recordings"][0]["result"]
    if tables.identifies_arm(first):
        yield tables.parameters(first)
    yield from [*tables.effects(first), *tables.day_to_day(joint)]
    for number, one in enumerate(joint["recordings"], 1):
        yield f"\nRecording {number}: {one['name']}"
        yield from lines_of({key: value for key, value in one["result"].items() if key != "effects"}, arm=False)
    yield from _files(joint)


def lines_of(result: dict[str, Any], *, arm: bool = True) -> Iterator[str | Table]:
    """A result (content of result.json, with 'verification', 'held_out', 'gaps', 'files' where there are), with the table of the arm or
    without."""
    yield from (f"*** {sentence} ***" for sentence in result_io.caveats(result))
    if arm and tables.identifies_arm(result):
        yield tables.parameters(result)
    yield from (*tables.fixed_scanners(result), tables.hand_eye(result))
    for lines in tables.SAID:
        yield from lines(result)
    if result.get("verification"):
        yield tables.verification(result["verification"])
        yield from [*tables.figures(result["verification"]), *tables.judgement(result)]
    if result.get("held_out"):
        yield tables.held_out(result["held_out"])
    yield from (f"About the recording: {gap}" for gap in result.get("gaps") or ())
    yield from _files(result)


def _files(result: dict[str, Any]) -> Iterator[str]:
    return (f"{name}: {path}" for name, path in (result.get("files") or {}).items())
