"""Options of ``mbcacq export`` that concern results and certificates, and what they do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

_OPTIONS = (
    click.option(
        "--results",
        type=click.Path(path_type=Path, file_okay=False),
        help="Write the calibration of RUN (a folder with result.json, or that file) into this folder: JSON, CSV, KUKA, ROS.",
    ),
    click.option("--tool", type=click.IntRange(1, 128), default=1, show_default=True, help="With --results: number of TOOL_DATA."),
    click.option("--tool-name", default="mbcacq scanner", show_default=True, help="With --results: TOOL_NAME."),
    click.option("--config-dat", type=click.Path(path_type=Path), help="With --results: a $config.dat to write a unified diff against."),
    click.option("--urdf", type=click.Path(path_type=Path), help="With --results: a URDF or xacro to write a calibrated copy of."),
    click.option("--joint", "joints", multiple=True, help="With --urdf: its moving joints, base first (default: all revolute ones)."),
    click.option("--flange-frame", default="tool0", show_default=True, help="With --results: name of the flange in ROS."),
    click.option("--scanner-frame", default="scanner_frame", show_default=True, help="With --results: name of the scanner in ROS."),
    click.option(
        "--artefact",
        metavar="ID",
        help="RUN is a certificate (CSV, YAML, DMIS output): write it as the artefact file ID.yaml here, or where --output says.",
    ),
    click.option("--output", type=click.Path(path_type=Path, dir_okay=False), help="With --artefact: the file to write."),
)


def result_options(command: Callable) -> Callable:
    """Add the options to a click command; it takes them as keyword arguments and passes them on to :func:`export_results`."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def export_results(
    source: Path, *, results: Path | None, artefact: str | None, output: Path | None, force: bool = False, **targets: Any
) -> list[dict[str, Any]]:
    """Do what the options ask for; what was written, each with its 'file' and what there is to say of it, none where nothing was asked."""
    written = []
    if results is not None:
        written += _results(source, results, targets, force)
    if artefact is not None:
        written.append(_artefact(source, artefact, output or Path(f"{artefact}.yaml"), force))
    return written


def _results(source: Path, folder: Path, targets: dict[str, Any], force: bool) -> list[dict[str, Any]]:
    from mbcacq.errors import ConfigError
    from mbcacq.exports.folder import Targets, contents, write_folder
    from mbcacq.exports.result_json import load_result
    from mbcacq.recording import load_observations

    result = load_result(source)
    if folder.resolve() == (source if source.is_dir() else source.parent).resolve():
        raise ConfigError(f"{folder} is where the result lies; give another folder")
    if (folder / "result.json").exists() and not force:
        raise ConfigError(f"{folder} already holds an export; give another folder, or --force to replace it")
    observations = load_observations(source) if source.is_dir() else None
    files = contents(result, Targets(**targets), observations)
    return [{"file": str(path)} for path in write_folder(files, folder)]


def _artefact(source: Path, artefact_id: str, output: Path, force: bool) -> dict[str, Any]:
    from mbcacq.errors import ConfigError, RecordingError
    from mbcacq.exports.certificate import artefact_yaml, read_certificate

    if output.exists() and not force:
        raise ConfigError(f"{output} exists; give another --output, or --force to replace it")
    found = read_certificate(source, artefact_id)
    try:
        output.write_text(artefact_yaml(found), encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"{output}: cannot be written: {error.strerror}") from error
    return {"file": str(output), "balls": len(found.ball_ids), "uncertainty_mm": found.uncertainty_mm}
