"""``mbcacq verify``: a calibrated arm, with its effects, tried on a recording that it was not fitted to."""

from __future__ import annotations

from pathlib import Path

import mbcacq
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import put_to_use
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress


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

    Example: mbcacq verify result.json another-day --place fitted
    """
    from mbcacq.workflow.load import unsealed_note

    found = []
    with StepProgress() as steps:
        for number, path in enumerate(other, 1):
            steps.begin(f"trying the arm on recording {number} of {len(other)}")
            found.append(mbcacq.verify_elsewhere(path, result, place=place))
    shown = (one.text for one in found)
    document = {"format": "mbcacq-transfer/1", "transfers": [one.to_dict() for one in found]}
    return Answer(document, shown, put_to_use(result), warnings=unsealed_note(result))
