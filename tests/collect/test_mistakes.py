"""The twelve mistakes of a session that nobody supervises: each is named, and none gives a wrong number."""

import os
import shutil

import numpy as np
import pytest
from session import cloud, content, loaded, noisy, play, rewrite, written_plan

from mbcacq.acquisition.collected.collected_run import CollectedRun
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.devices import ConfigError
from mbcacq.spheres.cloud_files import CloudFormat
from mbcacq.workflow.collect import Sources, pair_clouds


def paired(rehearsed, clouds, plan=None, **more):
    """Names of the cloud at each pose, and what was odd."""
    found = pair_clouds(loaded(plan or rehearsed / "plan.yaml"), Sources(clouds, **more))
    return {here.pose.number: [path.name for path in here.clouds] for here in found.poses}, [text for _, text in found.notes], found


def in_order(poses, left_out=()):
    return poses == {k: [f"cloud_{k + 1:04d}.ply"] for k in range(16) if k not in left_out}


def left_out(found, plan):
    """Numbers of the poses that the checks of a run leave out."""
    heard = []
    session = found.session
    CollectedRun(
        loaded=loaded(plan),
        n_poses=16,
        poses=found.poses,
        notes=[],
        bus=EventBus([heard.append]),
        read=session.read,
        find_balls=session.find,
        cell_yaml="",
        versions={},
    ).run()
    return [e.pose for e in heard if type(e).__name__ == "Gap" and e.kind == "pose"]


def test_a_session_without_mistakes_says_nothing(rehearsed, clouds):
    poses, notes, found = paired(rehearsed, clouds)
    assert in_order(poses)
    assert notes == []
    assert left_out(found, rehearsed / "plan.yaml") == []


def test_1_missing(rehearsed, clouds):
    cloud(clouds, 5).unlink()
    poses, notes, _ = paired(rehearsed, clouds)
    assert in_order(poses, left_out=[4])
    assert notes == ["pose 4: its cloud is missing, pose left out"]


def test_2_doubled_as_a_file(rehearsed, clouds):
    shutil.copy2(cloud(clouds, 5), cloud(clouds, 17))
    poses, notes, _ = paired(rehearsed, clouds)
    assert in_order(poses)
    assert notes == ["cloud_0017.ply is the same file as cloud_0005.ply, saved twice; it is left out"]


def test_2_doubled_as_an_exposure(rehearsed, clouds):
    for k in range(16, 5, -1):
        cloud(clouds, k).rename(cloud(clouds, k + 1))
    shutil.copy2(cloud(clouds, 5), cloud(clouds, 6))
    rewrite(cloud(clouds, 6), noisy)
    poses, notes, _ = paired(rehearsed, clouds)
    assert poses[15] == ["cloud_0017.ply"]
    assert len(notes) == 1
    assert "shows pose 4 once more than was asked for" in notes[0]


def test_3_late(rehearsed, clouds):
    age = cloud(clouds, 5).stat()
    shutil.copy2(cloud(clouds, 6), cloud(clouds, 5))
    rewrite(cloud(clouds, 5), noisy)
    os.utime(cloud(clouds, 5), (age.st_atime, age.st_mtime))
    _, notes, found = paired(rehearsed, clouds)
    assert len(notes) == 1
    assert "it shows pose 5 (taken late, after the arm had moved on?)" in notes[0]
    assert left_out(found, rehearsed / "plan.yaml") == [4]


@pytest.mark.parametrize("share", [0.5, 0.999, 0.0])
def test_4_half_written(rehearsed, clouds, share):
    data = cloud(clouds, 5).read_bytes()
    cloud(clouds, 5).write_bytes(data[: int(share * len(data))])
    poses, notes, _ = paired(rehearsed, clouds)
    assert in_order(poses, left_out=[4])
    assert any("cut off" in text or "is empty" in text for text in notes)


def test_5_swapped(rehearsed, clouds):
    for a, b in (("cloud_0005.ply", "x.ply"), ("cloud_0012.ply", "cloud_0005.ply"), ("x.ply", "cloud_0012.ply")):
        (clouds / a).rename(clouds / b)
    poses, notes, found = paired(rehearsed, clouds, by="number")
    assert poses[4] == ["cloud_0012.ply"]
    assert poses[11] == ["cloud_0005.ply"]
    assert sorted(text[:14] for text in notes) == ["cloud_0005.ply", "cloud_0012.ply"]
    assert all("exchanged or renamed?" in text for text in notes)
    assert left_out(found, rehearsed / "plan.yaml") == []


def test_6_another_plan(rehearsed, clouds, tmp_path):
    steps = content()["steps"]
    steps[0]["offsets_mm"] = steps[0]["offsets_mm"][:2]
    for step, views in ((1, ((10, 100), (200, -120), (30, 150), (100, -10))), (2, ((10, -100), (200, 120), (30, -150), (100, 60)))):
        steps[step]["views"] = [{"tilt_deg": 14, "azimuth_deg": a, "roll_deg": r} for a, r in views]
    with pytest.raises(ConfigError, match="do not show what the poses of this plan would: are they of another plan"):
        paired(rehearsed, clouds, plan=written_plan(tmp_path, steps=steps))


def test_6_the_program_of_another_plan(rehearsed, clouds, tmp_path):
    shutil.copy(rehearsed / "program" / "poses.csv", clouds)
    assert in_order(paired(rehearsed, clouds)[0])
    with pytest.raises(ConfigError, match="poses.csv: the robot program was written for another plan"):
        paired(rehearsed, clouds, plan=written_plan(tmp_path, name="plan", exposures=2))


@pytest.mark.parametrize(("unit", "said", "factor"), [("m", "m", 1e-3), ("in", "inches", 1 / 25.4), ("um", "um", 1e3)])
def test_7_another_unit(rehearsed, clouds, unit, said, factor):
    for path in clouds.glob("*.ply"):
        rewrite(path, lambda points: points * factor)
    with pytest.raises(ConfigError, match=f"the clouds are in {said}, not in mm.*--unit {unit}"):
        paired(rehearsed, clouds)
    assert in_order(paired(rehearsed, clouds, form=CloudFormat(unit))[0])


@pytest.mark.parametrize("shift", [4.0, 12.0, 40.0])
def test_8_a_moved_artefact(rehearsed, tmp_path, shift):
    bump = {"kind": "bumped_tripod", "station": "p2", "shift_mm": [shift, 0, 0], "from_arrival": 15}
    plan = written_plan(tmp_path, fake={"mishaps": [bump]})
    clouds = play(plan, rehearsed / "program", tmp_path / "clouds")
    _, notes, found = paired(rehearsed, clouds)
    assert len(notes) == 1
    assert "the artefact at station 'p2' was moved by" in notes[0]
    assert "between pose 11 and pose 12" in notes[0]
    assert float(notes[0].split("moved by ")[1].split(" mm")[0]) == pytest.approx(shift, abs=1.5)
    if shift > 10:
        assert left_out(found, rehearsed / "plan.yaml") == [12, 13, 14, 15]


def test_9_stopped_half_way(rehearsed, clouds):
    for k in range(12, 17):
        cloud(clouds, k).unlink()
    poses, notes, _ = paired(rehearsed, clouds)
    assert in_order(poses, left_out=range(11, 16))
    assert notes == ["the session ended after pose 10: 5 poses remain; write a program for them with --resume"]


def test_10_renamed(rehearsed, clouds):
    order = np.random.default_rng(3).permutation(16)
    for k in range(1, 17):
        cloud(clouds, k).rename(clouds / f"a{k}.ply")
    for k in range(1, 17):
        (clouds / f"a{k}.ply").rename(cloud(clouds, int(order[k - 1]) + 1))
    poses, notes, _ = paired(rehearsed, clouds)
    assert poses == {k: [f"cloud_{order[k] + 1:04d}.ply"] for k in range(16)}
    assert len(notes) == 1
    assert "the names of the clouds are not in the order in which they were taken" in notes[0]


@pytest.mark.parametrize(
    ("columns", "axes"), [(([0, 1, 2], [1, -1, -1]), "x -y -z"), (([1, 2, 0], [1, 1, 1]), "z x y"), (([0, 1, 2], [1, 1, -1]), "x y -z")]
)
def test_11_other_axes(rehearsed, clouds, columns, axes):
    for path in clouds.glob("*.ply"):
        rewrite(path, lambda points: points[:, columns[0]] * columns[1])
    with pytest.raises(ConfigError, match=f"have other axes than the plan's scanner frame.*--axes '{axes}'"):
        paired(rehearsed, clouds)
    assert in_order(paired(rehearsed, clouds, form=CloudFormat(axes=axes))[0])


def test_12_another_flange(rehearsed, tmp_path):
    hand_eye = content()["hand_eye"]
    about_z = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = {name: (about_z @ np.array(hand_eye[name])).tolist() for name in ("rotation", "translation_mm")}
    clouds = play(written_plan(tmp_path, hand_eye=turned), rehearsed / "program", tmp_path / "turned")
    with pytest.raises(ConfigError, match="the scanner is turned by -90° about its own axis against the plan's hand_eye"):
        paired(rehearsed, clouds)


def test_12_an_adapter_plate(rehearsed, tmp_path):
    hand_eye = content()["hand_eye"]
    hand_eye["translation_mm"][2] += 40.0
    clouds = play(written_plan(tmp_path, hand_eye=hand_eye), rehearsed / "program", tmp_path / "plate")
    with pytest.raises(ConfigError, match=r"the scanner sits 4\d mm and \d° from where the plan's hand_eye puts it"):
        paired(rehearsed, clouds)


def test_a_folder_without_clouds_is_named(rehearsed, tmp_path):
    with pytest.raises(ConfigError, match="holds no clouds"):
        paired(rehearsed, tmp_path)
    (tmp_path / "a.ply").write_bytes(b"nothing")
    with pytest.raises(ConfigError, match="none of 1 clouds can be read"):
        paired(rehearsed, tmp_path)
