"""What a dry run gave says so in every file, and goes onto a controller only on request."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
import read_back
from click.testing import CliRunner
from test_urdf import URDF

import mbcacq
from mbcacq.cli.app import app
from mbcacq.cli.export import command
from mbcacq.errors import ConfigError, ExitCode
from mbcacq.model.cell import SIMULATED
from mbcacq.recording.datasets.observation_set import read_observation_set, write_observation_set


@pytest.fixture
def simulated_file(solved, tmp_path):
    """The result.json of a dry run."""
    path = tmp_path / "result.json"
    path.write_text(json.dumps(solved[0] | {"simulated": True}))
    return path


def test_a_calibration_of_simulated_observations_says_so(solved):
    _, observations, _, _ = solved
    content = mbcacq.calibrate(replace(observations, cell=replace(observations.cell, simulated=True))).to_dict()
    assert content["simulated"] is True
    assert "simulated" not in mbcacq.calibrate(observations).to_dict()


def test_an_observation_set_keeps_that_it_is_simulated(solved, tmp_path):
    _, observations, _, _ = solved
    write_observation_set(replace(observations, cell=replace(observations.cell, simulated=True)), tmp_path / "set")
    assert "simulated: true" in (tmp_path / "set" / "cell.yaml").read_text()
    assert read_observation_set(tmp_path / "set").cell.simulated
    write_observation_set(observations, tmp_path / "measured")
    assert "simulated" not in (tmp_path / "measured" / "cell.yaml").read_text()


def test_a_simulated_result_is_refused_for_a_controller(simulated_file, tmp_path):
    outcome = CliRunner().invoke(command, [str(simulated_file), "--results", str(tmp_path / "out")])
    assert isinstance(outcome.exception, ConfigError)
    assert outcome.exception.exit_code == ExitCode.USAGE
    assert "--simulated-anyway" in str(outcome.exception)
    assert not (tmp_path / "out").exists()


def test_every_file_of_a_simulated_result_says_so(solved, simulated_file, tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF)
    (tmp_path / "config.dat").write_bytes(b"DEFDAT\r\nTOOL_DATA[1]={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}\r\nENDDAT\r\n")
    out = tmp_path / "out"
    arguments = [simulated_file, "--results", out, "--simulated-anyway", "--urdf", tmp_path / "arm.urdf", "--config-dat"]
    done = CliRunner().invoke(app, ["export", *map(str, arguments), str(tmp_path / "config.dat")])
    assert done.exit_code == 0, done.output
    assert SIMULATED in done.stderr
    for path in out.iterdir():
        if path.suffix == ".csv":
            rows = list(csv.DictReader(io.StringIO(path.read_text())))
            assert {row["simulated"] for row in rows} == {"true"}, path.name
        elif path.suffix == ".json":
            assert '"simulated"' in path.read_text(), path.name
        else:
            assert "simulated: true" in path.read_text(), path.name
    T = np.array(solved[0]["T_flange_scanner"])
    np.testing.assert_allclose(read_back.tool_data((out / "tool_data.txt").read_text(), 1), T, atol=1e-5)
    np.testing.assert_allclose(read_back.hand_eye(out / "mbcacq.calib"), T, atol=1e-9)
    assert (out / "static_transform.sh").read_text().startswith("#!/bin/sh\n")
    compile((out / "scanner.launch.py").read_text(), "scanner.launch.py", "exec")


def test_a_result_that_was_never_verified_says_so(solved, tmp_path):
    path = tmp_path / "result.json"
    path.write_text(json.dumps(solved[0] | {"verification": None}))
    done = CliRunner().invoke(app, ["export", str(path), "--results", str(tmp_path / "out")])
    assert "never verified" in done.stderr
    assert "never verified" in (tmp_path / "out" / "tool_data.txt").read_text()
    path.write_text(json.dumps(solved[0]))
    done = CliRunner().invoke(app, ["export", str(path), "--results", str(tmp_path / "again")])
    assert "never verified" not in done.stderr


def test_the_report_of_a_simulated_result_begins_with_it(solved, tmp_path):
    from mbcacq.report.write import report_from_result

    result, observations, _, _ = solved
    page = report_from_result(result | {"simulated": True}, path=tmp_path / "a.html", observations=observations).read_text()
    assert f'<p class="caveat">{SIMULATED.capitalize()}.</p>' in page
    page = report_from_result(result, path=tmp_path / "b.html", observations=observations).read_text()
    assert '<p class="caveat">' not in page
