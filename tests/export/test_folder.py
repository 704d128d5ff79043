"""All formats of one result, through the command line's options."""

import json
from pathlib import Path

import numpy as np
import pytest
import read_back
from click.testing import CliRunner
from test_urdf import CHAIN, URDF, follow

from mbcacq.cli.export import command
from mbcacq.errors import ConfigError
from mbcacq.exports.format import chains
from mbcacq.exports.result_json import load_result


def run(*arguments):
    outcome = CliRunner().invoke(command, [str(a) for a in arguments])
    if outcome.exception is not None and not isinstance(outcome.exception, SystemExit):
        raise outcome.exception
    return outcome


def test_every_format_has_the_same_hand_eye_transform(solved, result_file, tmp_path):
    out = tmp_path / "out"
    assert run(result_file, "--results", out, "--tool", 7).exit_code == 0
    T = np.array(solved[0]["T_flange_scanner"])
    np.testing.assert_allclose(read_back.tool_data((out / "tool_data.txt").read_text(), 7), T, atol=1e-5)
    np.testing.assert_allclose(read_back.hand_eye(out / "mbcacq.calib"), T, atol=1e-9)
    assert load_result(out) == solved[0]
    assert {p.name for p in out.iterdir()} >= {
        "parameters.csv",
        "covariance.csv",
        "verification.csv",
        "result.schema.json",
        "scanner.launch.py",
    }


def test_the_hand_eye_is_the_true_one(solved):
    T, truth = np.array(solved[0]["T_flange_scanner"]), solved[3]
    assert np.linalg.norm(T[:3, 3] - truth[:3, 3]) < 0.1
    np.testing.assert_allclose(T[:3, :3], truth[:3, :3], atol=5e-4)


def test_the_patched_urdf_is_the_calibrated_arm(solved, result_file, tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF)
    run(result_file, "--results", tmp_path / "out", "--urdf", tmp_path / "arm.urdf")
    patched = (tmp_path / "out" / "arm.urdf").read_bytes()
    tool = np.linalg.inv(follow(URDF.encode(), np.zeros(6))) @ CHAIN.flange(np.zeros((1, 6)))[0]
    _, calibrated = chains(solved[0])
    q = np.random.default_rng(0).uniform(-1, 1, 6)
    np.testing.assert_allclose(follow(patched, q) @ tool, calibrated.flange(q[None])[0], atol=2e-5)
    in_urdf = follow(patched, q, last="tool0-scanner_frame")
    np.testing.assert_allclose(in_urdf, calibrated.flange(q[None])[0] @ solved[0]["T_flange_scanner"], atol=2e-5)


def test_the_export_has_a_diff_against_the_controllers_file(result_file, tmp_path):
    (tmp_path / "config.dat").write_bytes(b"DEFDAT\r\nTOOL_DATA[2]={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}\r\nENDDAT\r\n")
    run(result_file, "--results", tmp_path / "out", "--tool", 2, "--config-dat", tmp_path / "config.dat")
    diff = (tmp_path / "out" / "config.dat.diff").read_bytes()
    assert b"-TOOL_DATA[2]={X 0.0," in diff
    assert b"+TOOL_DATA[2]={X " in diff


def test_nothing_is_written_where_one_target_does_not_fit(result_file, tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF.replace("0.455", "0.555"))
    with pytest.raises(ConfigError, match="joint 'a3'"):
        run(result_file, "--results", tmp_path / "out", "--urdf", tmp_path / "arm.urdf")
    assert not (tmp_path / "out").exists()


def test_the_original_is_not_overwritten(result_file):
    with pytest.raises(ConfigError, match="where the result lies"):
        run(result_file, "--results", result_file.parent)


def test_a_certificate_becomes_an_artefact_file(tmp_path):
    (tmp_path / "c.dmo").write_text("FA(S1)=FEAT/SPHERE,OUTER,CART,1,2,3,12\nFA(S2)=FEAT/SPHERE,OUTER,CART,31,2,3,12\n")
    out = tmp_path / "mbc.yaml"
    assert "2 balls" in run(tmp_path / "c.dmo", "--artefact", "mbc", "--output", out).output
    with pytest.raises(ConfigError, match="--force"):
        run(tmp_path / "c.dmo", "--artefact", "mbc", "--output", out)
    assert run(tmp_path / "c.dmo", "--artefact", "mbc", "--output", out, "--force").exit_code == 0


def test_an_export_without_a_target_is_refused(result_file):
    with pytest.raises(ConfigError, match="nothing to export"):
        run(result_file)


def test_what_was_written_is_printed_as_json(result_file, tmp_path):
    said = json.loads(run(result_file, "--results", tmp_path / "out", "--json").stdout)
    assert said["format"] == "mbcacq-export/1"
    assert {w["file"] for w in said["written"]} == {str(p) for p in (tmp_path / "out").iterdir()}
    (tmp_path / "c.csv").write_text("label,x,y,z,d,U,k\nS1,1,2,3,12,0.002,2\nS2,31,2,3,12,0.002,2\n")
    said = json.loads(run(tmp_path / "c.csv", "--artefact", "mbc", "--output", tmp_path / "mbc.yaml", "--json").stdout)
    assert said["written"] == [{"file": str(tmp_path / "mbc.yaml"), "balls": 2, "uncertainty_mm": 0.001}]


def test_an_earlier_export_is_replaced_only_with_force(result_file, tmp_path):
    out = tmp_path / "out"
    run(result_file, "--results", out, "--tool", 7)
    before = (out / "tool_data.txt").read_bytes()
    with pytest.raises(ConfigError, match="--force"):
        run(result_file, "--results", out, "--tool", 8)
    assert (out / "tool_data.txt").read_bytes() == before
    run(result_file, "--results", out, "--tool", 8, "--force")
    assert (out / "tool_data.txt").read_bytes() != before


def test_a_folder_with_a_result_alone_is_exported_without_residuals(result_file, tmp_path):
    from mbcacq import export

    written = [Path(one["file"]).name for one in export(result_file.parent, results=tmp_path / "out")]
    assert "arm.mjcf.xml" in written
    assert "residuals.csv" not in written
