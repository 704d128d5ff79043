"""Write recordings and results in the formats of other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.errors import ConfigError
from mbcacq.exports.certificate import read_certificate_file
from mbcacq.exports.folder import contents
from mbcacq.exports.format import Targets
from mbcacq.exports.result_json import load_result
from mbcacq.files.atomic_write import write_file, write_files
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets.cell_writer import artefact_to_yaml
from mbcacq.recording.datasets.observation_set import write_observation_set
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.scan_export import scans_to_write
from mbcacq.recording.rrd.trajectory_recording import export_trajectory
from mbcacq.workflow.load import load_observations, refuse_existing

Source = CalibratedCell | Observations | Path | str


def export(
    source: Source,
    *,
    observations: Path | str | None = None,
    scans: bool = False,
    trajectory: Path | str | None = None,
    results: Path | str | None = None,
    targets: Targets | None = None,
    force: bool = False,
    simulated_anyway: bool = False,
) -> list[dict[str, Any]]:
    """Write observations, trajectories or results in the formats of other programs.

    Parameters
    ----------
    source
        A run folder, a recording, an observation set, a result.json; or a calibration, observations.
    observations
        Folder for an observation set (cell.yaml, poses.csv, centres.csv).
    scans
        Write the raw clouds too, with ``observations``.
    trajectory
        Folder for the controller cycles as a trajectory set.
    results
        Folder for the calibration as JSON, CSV, KUKA, ROS and URDF.
    targets
        Which formats of ``results``, and their names and numbers.
    force
        Replace what exists.
    simulated_anyway
        Write ``results`` of a simulated calibration too.

    Returns
    -------
    list of dict
        One entry for each file or folder: its 'file', and remarks on it.

    Raises
    ------
    ConfigError
        Nothing is asked for, the output exists, or the source does not fit.
    RecordingError
        Writing fails.
    """
    written = list(_results(source, Path(results), targets or Targets(), force, simulated_anyway)) if results is not None else []
    folders = [None if folder is None else Path(folder) for folder in (observations, trajectory)]
    if not (written or any(folders)):
        raise ConfigError(
            "nothing to export; say what and where, such as --observations DIR, --results DIR, or --artefact ID for a certificate"
        )
    for folder in folders:
        if folder is not None:
            refuse_existing(folder / "cell.yaml", force, f"{folder} already holds a set; give another folder, or --force to replace it")
    if folders[0] is not None:
        written += _observations(source, folders[0], scans)
    if folders[1] is not None:
        written.append(_trajectory(source, folders[1]))
    return written


def export_artefact(certificate: Path | str, artefact_id: str, out: Path | str | None = None, *, force: bool = False) -> dict[str, Any]:
    """Write a certificate (CSV, YAML, DMIS output) as an artefact file (default: ID.yaml): 'file', 'balls', 'uncertainty_mm', 'notes'.

    Raises ConfigError for a damaged certificate or where the file exists, RecordingError if it cannot be written.
    """
    output = Path(out) if out is not None else Path(f"{artefact_id}.yaml")
    refuse_existing(output, force, f"{output} exists; give another --output, or --force to replace it")
    certified = read_certificate_file(Path(certificate), artefact_id)
    found = certified.artefact
    notes = {"notes": list(certified.notes)} if certified.notes else {}
    write_file(output, artefact_to_yaml(found))
    return {"file": str(output), "balls": len(found.ball_ids), "uncertainty_mm": found.uncertainty_mm} | notes


def _results(source: Source, folder: Path, targets: Targets, force: bool, simulated_anyway: bool) -> Iterator[dict[str, Any]]:
    measured = None
    if isinstance(source, CalibratedCell):
        result = source.to_dict()
        measured = None if source.own_fit is None else source.own_fit.observations
    else:
        path = _path(source, "its calibration")
        result = load_result(path)
        if folder.resolve() == (path if path.is_dir() else path.parent).resolve():
            raise ConfigError(f"{folder} is where the result lies; give another folder")
    if result.get("simulated") and not simulated_anyway:
        raise ConfigError(
            "this calibration is simulated, and on a controller it would be taken for a measured one; "
            "give that of a real arm, or --simulated-anyway"
        )
    if isinstance(source, Path | str) and Path(source).is_dir() and (layout.parts(Path(source)) or Path(source, "cell.yaml").exists()):
        measured = load_observations(source)
    marks = {"simulated": True} if result.get("simulated") else {}
    files = contents(result, targets, measured)
    for name in files:
        refuse_existing(folder / name, force, f"{folder} already holds {name}; give another folder, or --force to replace it")
    for path in write_files(folder, files):
        yield {"file": str(path)} | marks


def _observations(source: Source, folder: Path, scans: bool) -> list[dict[str, Any]]:
    if isinstance(source, CalibratedCell):
        measured = source.fit.observations
    else:
        measured = source if isinstance(source, Observations) else load_observations(source)
    clouds = {}
    if scans:
        clouds = scans_to_write(_path(source, "its scans"))
    write_observation_set(measured, folder, clouds)
    marks = {"simulated": True} if measured.cell.simulated else {}
    written: list[dict[str, Any]] = [marks | {"file": str(folder), "poses": measured.n_poses, "centres": measured.n_centres}]
    if scans:
        written.append({"file": str(folder / "scans"), "clouds": len(clouds)})
    return written


def _trajectory(source: Source, folder: Path) -> dict[str, Any]:
    return {"file": str(folder), "samples": export_trajectory(_path(source, "its controller cycles"), folder)}


def _path(source: Source, what: str) -> Path:
    """The place of a recording. Raises ConfigError for an object in memory."""
    if isinstance(source, Path | str):
        return Path(source)
    raise ConfigError(f"a recording is needed for {what}; give a run folder or a .rrd")
