"""``mbcacq verify``: a calibrated arm, with its effects, tried on a recording that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mbcacq
from mbcacq.calibration import result_io, transfer
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line, put_to_use
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.errors import ConfigError
from mbcacq.workflow import load


@subcommand("verify")
def command(
    result: Path = argument(RunPath()),
    other: tuple[Path, ...] = argument(RunPath(), required=True),
    place: str = option(
        "fitted: base, tool and stations of OTHER are fitted to it; known: they stand where RESULT has them, nothing is fitted, and "
        "poses at other stations are left out.",
        ["fitted", "known"],
        default="fitted",
    ),
) -> Answer:
    """Try the arm of RESULT (a result.json, or a run folder that holds one), with its effects, on each recording OTHER.

    The arm and its effects stay as they were learnt. Prints the misfit there of geometry alone and with the effects (in mm, and as chi2 per
    degree of freedom), and the gain of each effect. Also says how the errors compare with their stated uncertainty, and where OTHER leaves
    the range in which an effect was learnt. OTHER must be of the same arm as RESULT: of the same name and nominal links.

    The verdict on each OTHER is noted in RESULT, which then counts as verified or as contradicted.

    Example: mbcacq verify result.json another-day --place fitted
    """
    found = []
    with StepProgress() as steps:
        for number, path in enumerate(other, 1):
            steps.begin(f"trying the result on recording {number} of {len(other)}")
            found.append(mbcacq.verify_elsewhere(path, result, place=place))
    judged = {str(path): one for path, one in zip(other, found, strict=True) if one.verdict != "none"}
    learnt = result_io.read_result(result, any_of_them=True)
    warnings = [*load.unsealed_note(result), *map(str, learnt.get("warnings") or ())]
    if judged and result_io.split_number(result)[1] is None:
        try:
            result_io.note_trials(result, {name: one.judgement for name, one in judged.items()})
        except ConfigError as error:
            warnings = [*warnings, f"the verdict is not noted in the result: {error}"]
    document = {"format": "mbcacq-transfer/1", "transfers": [one.to_dict() for one in found]}
    return Answer(document, (one.text for one in found), _next(result, judged), warnings=warnings)


def _next(result: Path, judged: Mapping[str, transfer.Transfer]) -> tuple[str, str]:
    """What to do after the trial, and the command for it."""
    against = next((name for name, one in judged.items() if one.verdict == "contradicts"), None)
    if against is None:
        return put_to_use(result)
    alone = ("--hand-eye-only",) if result_io.of_flange_poses(result_io.read_result(result)) else ()
    return "see what that recording says by itself, before either result is used", command_line("calibrate", against, *alone)
