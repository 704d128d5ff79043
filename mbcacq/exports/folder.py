"""The formats of one result, written into a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbcacq.errors import ConfigError
from mbcacq.exports.format import ExportedResult, ExportFormat, Targets, formats
from mbcacq.exports.marks import with_comments
from mbcacq.exports.mount import UndeterminedMount
from mbcacq.model.observations import Observations


def contents(result: Mapping[str, Any], targets: Targets, observations: Observations | None = None) -> dict[str, bytes]:
    """File name -> content, of all formats or of those in ``targets.only``.

    Raises ConfigError if a target does not fit or two formats write one file, before anything is written.
    """
    exported = ExportedResult(result, targets, observations)
    files, owner = dict[str, bytes](), dict[str, str]()
    for one in formats(targets.only):
        for name, content in _files(one, exported).items():
            if name in files:
                raise ConfigError(f"the formats '{owner[name]}' and '{one.name}' both write {name}; choose by --only, or mend one package")
            if Path(name).name != name:
                raise ConfigError(f"the format '{one.name}' writes {name}, which is no plain file name; mend its package")
            owner[name] = one.name
            files[name] = content if isinstance(content, bytes) else with_comments(name, content, exported.comments).encode("utf-8")
    return files


def _files(one: ExportFormat, exported: ExportedResult) -> Mapping[str, str | bytes]:
    """The files of a format; none where it needs a frame on the flange that was not determined, unless it was asked for by name."""
    if one.of_joints and not exported.has_joints:
        if one.name in exported.targets.only:
            raise ConfigError(f"the format '{one.name}' holds joints, and this result is of poses of a flange; choose another by --only")
        return {}
    try:
        return one.files(exported)
    except UndeterminedMount:
        if one.name in exported.targets.only:
            raise
        return {}
