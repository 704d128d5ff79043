"""``mbcacq report``: everything that is known of a run, as one HTML page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click


@click.command("report")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The page [default: report.html in the folder of the run].")
@click.option("--diagnose", "with_diagnosis", is_flag=True, help="Make a diagnosis first, if there is none yet.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as one JSON object on stdout.")
def command(run: Path, out: Path | None, with_diagnosis: bool, as_json: bool) -> None:
    """Write the report of RUN: one HTML page that opens offline and prints well.

    RUN is a run folder, a recording (.rrd) or an observation set. A result that is there is used, otherwise the cell is calibrated; so is
    a diagnosis that 'mbcacq diagnose' left in the folder of a run.

    \b
    Examples:
      mbcacq report runs/today
      mbcacq report ur5-tracker --diagnose --out ur5.html
    """
    from mbcacq.calibration.accuracy_map import accuracy_map
    from mbcacq.errors import ConfigError
    from mbcacq.recording import find_gaps, load_observations
    from mbcacq.report import read_run_info, report_from_result

    if out is None and run.is_file():
        raise ConfigError(f"{run} is a file, no folder; say where the report is to go with --out")
    observations = load_observations(run)
    result = _result(run)
    if result is None or "accuracy_map" not in result:
        calibration, found = _calibrate(observations)
        result = (found if result is None else result) | {"accuracy_map": accuracy_map(calibration).to_dict()}
    if run.is_dir():
        result["gaps"] = find_gaps(run)
    info: dict[str, Any] = {"folder": str(run), "name": run.name} | (read_run_info(run) if run.is_dir() else {})
    if with_diagnosis and "diagnosis" not in info:
        info |= _diagnose(observations, run)
    path = report_from_result(result, path=out or run / "report.html", observations=observations, run_info=info)
    if as_json:
        click.echo(json.dumps({"format": "mbcacq-report/1", "report": str(path), "bytes": path.stat().st_size}))
    else:
        click.echo(str(path))


def _result(run: Path) -> dict[str, Any] | None:
    """The result.json of a run folder. Raises ConfigError where it is not readable."""
    if not (run.is_dir() and (run / "result.json").exists()):
        return None
    from mbcacq.cli.simulate import read_result

    return read_result(run)


def _calibrate(observations: Any) -> tuple[Any, dict[str, Any]]:
    from mbcacq.calibration import CalibrationOptions, calibrate, verify

    click.echo("calibrating ...", err=True)
    phase = observations.phase
    calibration = calibrate(observations, CalibrationOptions(refuse=phase is None or "position" in phase))
    return calibration, calibration.to_dict() | {"verification": verify(observations, calibration).to_dict()}


def _diagnose(observations: Any, run: Path) -> dict[str, Any]:
    from mbcacq.cli.diagnose import is_run
    from mbcacq.diagnosis.diagnose import diagnose
    from mbcacq.diagnosis.output.figures import pictures
    from mbcacq.workflow.diagnosis_files import keep_beside

    found = diagnose(observations, progress=lambda text: click.echo(f"{text} ...", err=True))
    if is_run(run):
        keep_beside(found, observations, run)
    return {"diagnosis": found.to_json(), "pictures": pictures(found)}
