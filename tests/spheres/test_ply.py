"""Clouds from files, as another laboratory writes them."""

from dataclasses import replace
from pathlib import Path

import clouds
import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.files.open3d_library import open3d
from mbcacq.model.cell import Station
from mbcacq.plan import load
from mbcacq.recording.datasets.scan_folder import centres_from_scans, write_ply
from mbcacq.spheres.ply import centres_from_ply, read_cloud

MBC = clouds.artefact()


@pytest.mark.parametrize("kind", ["float", "double"])
def test_a_text_ply_of_another_program(tmp_path, kind):
    points = clouds.scan(np.random.default_rng(0), MBC.centres, 12.0, spacing=0.5, plate_z=None)
    head = (
        f"ply\nformat ascii 1.0\ncomment by hand\nelement vertex {len(points)}\n"
        + "".join(f"property {kind} {c}\n" for c in "xyz")
        + "end_header\n"
    )
    path = tmp_path / "1.ply"
    path.write_text(head + "\n".join(f"{x:.5f} {y:.5f} {z:.5f}" for x, y, z in points) + "\n")
    found = centres_from_ply(path, MBC)
    assert tuple(found.ball) == MBC.ball_ids
    assert np.abs(found.xyz - MBC.centres).max() < 0.003


def test_a_binary_ply_is_read_exactly(tmp_path):
    points = np.random.default_rng(0).normal(size=(100, 3))
    o3d = open3d()
    o3d.io.write_point_cloud(str(tmp_path / "a.ply"), o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.ply"), points)


def test_clouds_of_an_observation_set_in_inches_are_said(tmp_path):
    cell = load(Path(__file__).parents[2] / "plans" / "quick.yaml").cell
    cell = replace(cell, artefacts=(MBC,), stations=(Station("p1", "mbc"),))
    points = clouds.scan(np.random.default_rng(0), MBC.centres, 12.0, spacing=0.5, plate_z=None)
    (tmp_path / "scans").mkdir()
    write_ply(tmp_path / "scans" / "1.ply", points / 25.4)
    with pytest.raises(ConfigError, match="shows no ball read in mm and 8 read in inches; convert the clouds from inches to mm"):
        centres_from_scans(tmp_path, cell, np.array([1]), np.array([0]))
    write_ply(tmp_path / "scans" / "1.ply", points)
    assert len(centres_from_scans(tmp_path, cell, np.array([1]), np.array([0]))["ball"]) == 8


@pytest.mark.parametrize("text", ["", "ply\n", "not a cloud at all"])
def test_a_file_that_is_no_cloud_is_named(tmp_path, text):
    path = tmp_path / "bad.ply"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"bad\.ply"):
        read_cloud(path)


def test_a_missing_or_foreign_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.ply: there is no such cloud"):
        read_cloud(tmp_path / "none.ply")
    (tmp_path / "x.txt").write_text("1 2 3")
    with pytest.raises(ConfigError, match=r"x\.txt"):
        read_cloud(tmp_path / "x.txt")
