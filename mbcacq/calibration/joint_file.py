"""The result of several recordings of one arm, format 'mbcacq-joint-result/1': one result for each recording, all with the same arm and
effects.

One of them is named by its number behind the file: ``result.json#2`` is the cell of the second recording.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mbcacq.calibration.sealed_json import unsealed
from mbcacq.errors import ConfigError
from mbcacq.model.formats import newer_format
from mbcacq.model.json_text import damage

FORMAT = "mbcacq-joint-result/1"
ONE_FORMAT = "mbcacq-result/1"  # of one recording


def joint_content(results: Sequence[dict[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """JSON content of the results of several recordings of these names. 'day_to_day': for each coefficient of the effects on the arm its
    values in the recordings, what they have in common and the standard deviation between them; it stands once, not in each result."""
    day_to_day = [one.pop("day_to_day", []) for one in results][0]
    recordings = [{"name": name, "result": one} for name, one in zip(names, results, strict=True)]
    return {"format": FORMAT, "recordings": recordings, "day_to_day": day_to_day}


def split_number(path: Path) -> tuple[Path, int | None]:
    """The file and the number of the recording in it that a path like ``result.json#2`` names; None where it names none."""
    found = re.fullmatch(r"(.+)#(\d+)", path.name)
    return (path, None) if path.exists() or not found else (path.with_name(found[1]), int(found[2]))


def result_of_one(content: Any, number: int | None, file: Path, *, any_of_them: bool = False) -> Any:
    """The result of one recording in a joint result; any other content as it is. any_of_them: without a number the first will do, where
    only what they share is asked for. Raises ConfigError where it is not said which, and where the content's checksum does not hold.
    """
    if isinstance(content, dict) and (sentence := newer_format(content.get("format"), (FORMAT, ONE_FORMAT))):
        raise ConfigError(f"{file} {sentence}")
    content = unsealed(content, file)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        if number is not None:
            raise ConfigError(f"{file} is not of several recordings; leave out '#{number}'")
        return content
    try:
        names, results = zip(*((str(one["name"]), one["result"]) for one in content["recordings"]), strict=True)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{file}: the joint result is damaged ({damage(error)}); write it anew with mbcacq calibrate") from error
    if number is None and any_of_them:
        number = 1
    if number is None or not 1 <= number <= len(results):
        choice = ", ".join(f"{file}#{i + 1} ({name})" for i, name in enumerate(names))
        raise ConfigError(f"{file} is of {len(results)} recordings with one arm, each with its own tool and stations; give one: {choice}")
    return results[number - 1]
