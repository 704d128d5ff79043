"""Export of a calibration result, or of a certificate as an artefact file."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def export_results(
    source: Path, *, results: Path | None, artefact: str | None, output: Path | None, force: bool = False, **targets: Any
) -> list[dict[str, Any]]:
    """Export the result of a run into the folder ``results``, or a certificate as the artefact file ``output``, or both, where given.

    targets: fields of ``folder.Targets``. Returns for each file its 'file' and its properties. Raises ConfigError where a file exists
    already (unless ``force``) or the source is wrong, RecordingError where a file cannot be written.
    """
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
