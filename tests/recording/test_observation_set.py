from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mbcacq.model.observations import Observations
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.cell_yaml import cell_to_yaml, parse_cell
from mbcacq.recording.datasets.observation_set import read_observation_set, write_observation_set

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


def assert_same(a: Observations, b: Observations) -> None:
    """Every array equal bit for bit."""
    for field in dataclasses.fields(Observations):
        left, right = getattr(a, field.name), getattr(b, field.name)
        if field.name == "cell":
            assert cell_to_yaml(left) == cell_to_yaml(right)
        elif isinstance(left, np.ndarray):
            assert left.dtype == right.dtype or left.dtype.kind == "U", field.name
            np.testing.assert_array_equal(left, right, err_msg=field.name)
        elif isinstance(left, dict):
            assert {k: v.tolist() for k, v in left.items()} == {k: v.tolist() for k, v in right.items()}, field.name
        else:
            assert left == right, field.name


def test_the_values_of_a_small_set_are_read(a_set):
    obs = load_observations(a_set)
    assert obs.pose_id.tolist() == [10, 11]
    assert obs.station.tolist() == [0, 1]
    assert obs.q[0, 1] == -np.pi / 2
    assert obs.pose.tolist() == [0, 0, 1]  # sorted by pose, whatever the file's order
    assert obs.ball.tolist() == [0, 1, 2]  # indices of the ids 1, 2, 7
    assert obs.xyz.tolist() == [[1, 2, 3], [-1, -2, -3], [4, 5, 6]]
    assert obs.n_points.tolist() == [100, 90, 120]
    assert obs.temperatures["air_C"].tolist() == [20.5, 20.75]
    assert obs.extra["poses.remark"].tolist() == ["first", "a, b"]
    assert obs.time_s is None
    assert obs.rotation is None
    assert "# a comment that must survive" in obs.cell_yaml


def test_movements_are_from_the_pose_measured_before(a_set):
    rows = ["pose,station,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,time_s", "10,1,0,-90,90,0,45,1,30", "11,far,10,-80,80,5,-45,0,20"]
    (a_set / "poses.csv").write_text("\n".join(rows) + "\n")
    obs = load_observations(a_set)
    assert obs.movement is not None
    np.testing.assert_allclose(np.degrees(obs.movement), [[-10, -10, 10, -5, 90, 1], [0, 0, 0, 0, 0, 0]], atol=1e-9)
    alone = obs.select(np.array([True, False]))
    assert alone.movement is not None
    np.testing.assert_array_equal(alone.movement, obs.movement[:1])


def test_columns_may_stand_in_any_order_with_crlf_and_byte_order_mark(a_set):
    before = load_observations(a_set)
    rows = [line.split(",", 9) for line in (a_set / "poses.csv").read_text().splitlines()]
    (a_set / "poses.csv").write_bytes(("\ufeff" + "\r\n".join(",".join(reversed(row)) for row in rows)).encode())
    assert_same(before, load_observations(a_set))


def test_what_was_read_is_written_back_without_loss(a_set, tmp_path):
    obs = load_observations(a_set)
    write_observation_set(obs, tmp_path / "copy")
    assert_same(obs, load_observations(tmp_path / "copy"))
    assert (tmp_path / "copy" / "cell.yaml").read_text() == (a_set / "cell.yaml").read_text()


@pytest.mark.parametrize("name", ["example-none", "example-compliance", "iiwa14-sockets", "panda-sockets", "ur5-tracker", "ur10-tracker-c"])
def test_measured_sets_survive_the_round_trip(shared_data, tmp_path, name):
    obs = load_observations(shared_data / name)
    write_observation_set(obs, tmp_path / "copy")
    assert_same(obs, load_observations(tmp_path / "copy"))


def test_measured_sets_are_read_whole(shared_data):
    counts = {
        name: (obs := load_observations(shared_data / name)).n_poses
        for name in ("iiwa14-sockets", "panda-sockets", "ur5-tracker", "ur10-tracker-a")
    }
    assert counts == {"iiwa14-sockets": 180, "panda-sockets": 387, "ur5-tracker": 1000, "ur10-tracker-a": 11911}
    assert obs.rotation.shape == (11911, 3, 3)
    np.testing.assert_allclose(np.linalg.det(obs.rotation), 1.0, atol=1e-12)
    assert load_observations(shared_data / "iiwa14-sockets").q.shape == (180, 7)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_arrays_survive_the_round_trip(a_set, tmp_path, data):
    cell = load_observations(a_set).cell
    poses = data.draw(st.integers(1, 6))

    def draw(*shape):
        return data.draw(hnp.arrays(np.float64, shape, elements=NUMBERS))

    per_pose = data.draw(st.lists(st.integers(0, 3), min_size=poses, max_size=poses).filter(any))
    pose = np.repeat(np.arange(poses), per_pose)
    m = len(pose)
    obs = Observations(
        cell=cell,
        pose_id=np.array(data.draw(st.lists(st.integers(-(10**9), 10**9), min_size=poses, max_size=poses, unique=True))),
        station=np.array(data.draw(st.lists(st.integers(0, 1), min_size=poses, max_size=poses))),
        q=np.clip(draw(poses, 6), -1e9, 1e9),
        pose=pose,
        ball=np.concatenate([np.arange(k) for k in per_pose]),
        xyz=draw(m, 3),
        phase=np.full(poses, "verification"),
        time_s=draw(poses),
        direction=data.draw(hnp.arrays(np.int64, (poses, 6), elements=st.integers(-1, 1))),
        torque=draw(poses, 6),
        current=draw(poses, 6),
        payload_kg=draw(poses),
        velocity=np.clip(draw(poses, 6), -1e9, 1e9),
        temperatures={"oil_C": draw(poses)},
        rms_mm=draw(m),
        extra={"poses.note": np.array(data.draw(st.lists(st.text('ab ,;"\n\u00e4', max_size=5), min_size=poses, max_size=poses)))},
        cell_yaml=(a_set / "cell.yaml").read_text(),
    )
    shutil.rmtree(tmp_path / "any", ignore_errors=True)
    write_observation_set(obs, tmp_path / "any")
    assert_same(obs, load_observations(tmp_path / "any"))


def test_a_changed_cell_is_written_anew(a_set, tmp_path):
    obs = load_observations(a_set)
    moved = obs.cell.T_flange_scanner.copy()
    moved[0, 3] += 0.125
    changed = dataclasses.replace(obs, cell=dataclasses.replace(obs.cell, T_flange_scanner=moved))
    write_observation_set(changed, tmp_path / "copy")
    np.testing.assert_array_equal(load_observations(tmp_path / "copy").cell.T_flange_scanner, moved)


def test_a_cell_survives_yaml_bit_for_bit(a_set):
    cell = load_observations(a_set).cell
    back = parse_cell(cell_to_yaml(cell))
    np.testing.assert_array_equal(back.robot.chain.rows, cell.robot.chain.rows)
    np.testing.assert_array_equal(back.T_flange_scanner, cell.T_flange_scanner)
    np.testing.assert_array_equal(back.ball_centres, cell.ball_centres)
    assert [s.id for s in back.stations] == ["1", "far"]
    assert back.robot.repeatability_mm == 0.02


def test_orientations_survive_the_round_trip(a_set):
    text = (a_set / "centres.csv").read_text().splitlines()
    half = "0.7071067811865476"
    (a_set / "centres.csv").write_text("\n".join([text[0] + ",qw,qx,qy,qz", *(f"{row},{half},0,0,{half}" for row in text[1:])]))
    obs = read_observation_set(a_set)
    np.testing.assert_allclose(obs.rotation[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)  # a quarter turn about z
    write_observation_set(obs, a_set)
    np.testing.assert_array_equal(load_observations(a_set).rotation, obs.rotation)
