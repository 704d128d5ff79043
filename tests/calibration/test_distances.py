"""An arm calibrated by distances: draw wires from points in the base to one point on the flange."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import mbcacq
from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.estimation.forward_model import CellState, predict
from mbcacq.estimation.identifiability import base_columns
from mbcacq.estimation.parameters import build
from mbcacq.files.table import read_table
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, Station
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets.cell_yaml import robot_of
from mbcacq.recording.datasets.length_table import read_lengths
from mbcacq.recording.datasets.loose_table import TableOptions

ARM = "kr10_r1100_2"
ENDS = np.array([[900.0, 300, 100], [-300, 800, 50]])
POINT = np.array([30.0, -20, 120])
OFFSET, SCALE, NOISE, REPEATABILITY = 3.0, 6e-5, 0.02, 1.7e-5  # mm, 1, mm, rad


def wires(rng, poses=120, count=1):
    """Observations of one wire after the other, and the true state."""
    robot = robot_of(ARM)
    q = rng.uniform(-1, 1, size=(8 * poses * count, 6)) * [1.5, 0.7, 1.0, 1.5, 1.2, 1.5] + [0, -1.2, 1.4, 0, 0, 0]
    q = q[robot.chain.flange(q)[:, 2, 3] > 150][: poses * count]
    P = len(q)
    target = Artefact("target", "", (1,), np.zeros((1, 3)), np.zeros(1), 0.0)
    stations = tuple(Station(f"w{k}", "target") for k in range(count))
    cell = Cell(robot, np.eye(4), (target,), stations, noise_mm=np.full(3, NOISE), measurement=TARGET_IN_BASE, length_scale=1e-4)
    obs = Observations(cell, np.arange(P), np.arange(P) // poses, q, np.arange(P), np.zeros(P, int), np.ones((P, 3)))
    free = build(obs, mbcacq.CalibrationOptions()).blocks[0].free.reshape(6, 5)
    chain = robot.chain.with_errors(np.where(free, rng.normal(size=(6, 5)) * [3e-4, 0.3, 0.3, 3e-4, 3e-4], 0.0))
    at = se3.apply(chain.flange(q + REPEATABILITY * rng.normal(size=q.shape)), np.tile(POINT, (P, 1)))
    length = (1 + SCALE) * np.linalg.norm(at - ENDS[obs.station], axis=1) + OFFSET + NOISE * rng.normal(size=P)
    places = np.array([se3.transform(np.eye(3), end) for end in ENDS[:count]])
    return replace(obs, xyz=np.c_[length, np.zeros((P, 2))]), CellState(chain, se3.transform(np.eye(3), POINT), places, np.zeros((1, 3)))


@pytest.mark.parametrize(("poses", "count"), [(120, 1), (60, 2)])
def test_a_wire_calibrates_arm_ends_and_offset_within_their_uncertainty(poses, count):
    obs, truth = wires(np.random.default_rng(3), poses, count)
    cell = mbcacq.calibrate(obs)
    said = cell.extra["length_instrument"]
    assert abs(said["offset_mm"] - OFFSET) < 4 * said["offset_std_mm"] < 0.5
    assert abs(said["scale"] - SCALE) < 4 * said["scale_std"]
    for found, true, C in zip(cell.state.T_base_station, truth.T_base_station, cell.fit.station_covariance, strict=True):
        assert (np.abs(found[:3, 3] - true[:3, 3]) < 4 * np.sqrt(np.diag(C)[:3])).all()
    # Distances between places of the point, which need no base, at postures that were not measured.
    q = np.random.default_rng(4).uniform(obs.q.min(axis=0), obs.q.max(axis=0), size=(200, 6))
    A, at = base_columns(cell.layout, cell.state, q, np.zeros((1, 3)))
    true = se3.apply(truth.chain.flange(q), np.tile(POINT, (200, 1)))
    nominal = se3.apply(obs.cell.robot.chain.flange(q), np.tile(POINT, (200, 1)))
    exact, ours, before = (np.linalg.norm(p[:100] - p[100:], axis=1) for p in (true, at, nominal))
    u = (at[:100] - at[100:]) / ours[:, None]
    row = np.einsum("pi,pig->pg", u, A[:100] - A[100:])
    std = np.sqrt(np.einsum("pg,gh,ph->p", row, cell.covariance, row))
    assert 0.2 < np.mean(((ours - exact) / std) ** 2) < 3.0
    assert np.sqrt(np.mean((ours - exact) ** 2)) < 0.5 * np.sqrt(np.mean((before - exact) ** 2))


def test_gross_errors_of_a_wire_are_rejected_by_name():
    obs, _ = wires(np.random.default_rng(5))
    obs.xyz[[7, 50], 0] += [12.0, -9.0]
    assert {r.pose for r in mbcacq.calibrate(obs).fit.rejected} == {7, 50}


def test_the_gradient_of_a_distance_is_its_change():
    obs, truth = wires(np.random.default_rng(6), 5)
    G = predict(obs, truth).gradient
    assert G.shape == (5, 1, 6)
    for k in range(6):
        step = 1e-4 * np.eye(6)[k] * (1 if k < 3 else 1e-3)
        moved = replace(truth, T_base_station=se3.exp(-step) @ truth.T_base_station)  # moving the wire back is moving the arm
        change = (predict(obs, moved).xyz - predict(obs, truth).xyz)[:, 0] / np.abs(step).max()
        np.testing.assert_allclose(G[:, 0, k], change, rtol=1e-4, atol=1e-5 * (1 if k < 3 else 1e3))


def table(tmp_path, obs, *, unit="mm", heading="wire", more=""):
    joints = ",".join(f"q{i}_deg" for i in range(1, 7))
    count = len(obs.cell.stations)
    names = [f"{heading}_{unit}"] if count == 1 else [f"{heading}{k + 1}_{unit}" for k in range(count)]
    lines = [f"{joints},{','.join(names)}{more and ',x,y,z'}"]
    factor = {"mm": 1.0, "m": 1e-3}[unit]
    for q, s, (length, *_) in zip(obs.q, obs.station, obs.xyz, strict=True):
        cells = ["" if k != s else repr(float(factor * length)) for k in range(count)]
        lines.append(",".join([*map(repr, np.degrees(q).tolist()), *cells]) + more)
    (tmp_path / "wire.csv").write_text("\n".join(lines) + "\n")
    return tmp_path / "wire.csv"


@pytest.mark.parametrize(("unit", "heading", "count"), [("m", "distance", 1), ("mm", "draw_wire", 2), ("mm", "ballbar length", 1)])
def test_tables_of_distances_are_understood_by_their_headings(unit, heading, count, tmp_path):
    obs, _ = wires(np.random.default_rng(3), 40, count)
    found = read_lengths(read_table(table(tmp_path, obs, unit=unit, heading=heading)), TableOptions(robot=robot_of(ARM)))
    assert found is not None
    np.testing.assert_allclose(found.observations.xyz, obs.xyz, rtol=1e-12)
    np.testing.assert_array_equal(found.observations.station, obs.station)
    assert len(found.observations.cell.stations) == count


def test_a_length_is_never_dropped_nor_read_as_a_sphere(tmp_path):
    obs, _ = wires(np.random.default_rng(3), 40)
    path = table(tmp_path, obs, more=",1,2,3")
    done = CliRunner().invoke(app, ["data", "new", str(path), "--robot", ARM, "--out", str(tmp_path / "set")])
    assert done.exit_code == 0, done.output
    assert "distances in wire_mm" in done.output
    assert "not used: x, y, z" in done.output
    again = mbcacq.load_observations(tmp_path / "set")
    assert again.cell.length_scale == 1e-4
    np.testing.assert_array_equal(again.xyz, obs.xyz)
    target = read_table(path)
    target.columns |= {f"target_{c}_mm": target.columns[c] for c in "xyz"}
    assert read_lengths(target, TableOptions(robot=robot_of(ARM))) is None


def test_the_wrong_arm_or_rows_are_refused(tmp_path):
    obs, _ = wires(np.random.default_rng(3), 40)
    read = read_table(table(tmp_path, obs))
    with pytest.raises(ConfigError, match=r"UR10e explains the distances .* check the arm"):
        read_lengths(read, TableOptions(robot=robot_of("ur10e")))
    with pytest.raises(ConfigError, match="name the arm"):
        read_lengths(read, TableOptions())


def test_every_command_works_with_distances_or_says_why_not(tmp_path):
    obs, _ = wires(np.random.default_rng(3), 60)
    where, result = str(tmp_path / "set"), str(tmp_path / "result.json")
    run = CliRunner()
    assert run.invoke(app, ["data", "new", str(table(tmp_path, obs)), "--robot", ARM, "--out", where]).exit_code == 0
    done = run.invoke(app, ["calibrate", where, "--out", result])
    assert "offset" in done.output
    assert "compare" in done.output
    for words in (
        ["calibrate", where, where], ["compare", where], ["report", where, "--out", str(tmp_path / "page.html")], ["diagnose", where],
        ["verify", result, where], ["export", result, str(tmp_path / "exported")],
    ):  # fmt: skip
        done = run.invoke(app, words)
        assert done.exit_code in (0, 2) or "diagnosed" in done.output, (words, done.output)
        assert done.exception is None or isinstance(done.exception, SystemExit), words
