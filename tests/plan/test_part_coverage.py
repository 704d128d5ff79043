"""Views of a part: what each shows, how few are enough, and a plan that takes them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from dry_runs import PLANS, plan_file

from mbcacq.cli.app import app
from mbcacq.design import part_coverage
from mbcacq.design.options import DesignOptions
from mbcacq.errors import ConfigError
from mbcacq.files.mesh_file import Mesh
from mbcacq.geometry import se3
from mbcacq.plan import load

OPTIONS = DesignOptions()


def part_alone(plan):
    plan["steps"] = plan["steps"][3:]
    plan["steps"][0]["views"] = plan["steps"][0]["views"][:2]
    plan["stations"] = plan["stations"][5:]
    plan["artefacts"] = plan["artefacts"][1:]


def rectangle(corner, u, v):
    """Two triangles (2, 3, 3)."""
    a, b, c, d = np.array(corner, dtype=float) + np.array([np.zeros(3), u, np.add(u, v), v])
    return np.array([[a, b, c], [a, c, d]])


def test_a_wall_hides_what_stands_behind_it_and_is_itself_seen_too_flat():
    plate = rectangle([-30, -30, 0], [60, 0, 0], [0, 60, 0])
    wall = rectangle([10, -30, 0], [0, 60, 0], [0, 0, 40])  # faces +x
    corners = np.concatenate([plate, wall]).reshape(-1, 3)
    mesh = Mesh(corners, np.arange(len(corners)).reshape(-1, 3))
    points = np.array([[-20.0, 0, 0], [14.0, 0, 0], [10.0, 0, 20.0]])
    normals = np.array([[0.0, 0, 1], [0, 0, 1], [1, 0, 0]])
    down, from_the_left = (se3.exp(np.r_[0, 0, 0, 0, np.radians(a), 0]) for a in (0.0, -35.0))
    loaded = load(PLANS / "part.yaml")
    shown = part_coverage._shown(loaded, mesh, points, normals, se3.inverse(np.stack([down, from_the_left])), OPTIONS)
    assert shown.tolist() == [[True, True, False], [True, False, False]]


def test_few_views_cover_all_and_hang_together():
    """Three stretches of 40 in 100 points cover all and overlap by a quarter of each, among many shorter ones."""
    rng = np.random.default_rng(0)
    shown = np.zeros((200, 100), dtype=bool)
    for k, (start, length) in enumerate(
        [(0, 40), (30, 40), (60, 40), *zip(rng.integers(0, 80, 197), rng.integers(5, 25, 197), strict=True)]
    ):
        shown[k, start : start + length] = True
    chosen = part_coverage.fewest_views(shown, replace(OPTIONS, overlap=0.25, coverage=1.0))
    assert sorted(chosen) == [0, 1, 2]
    chain = part_coverage.fewest_views(shown, replace(OPTIONS, overlap=0.5, coverage=1.0))
    assert shown[chain].any(axis=0).all()
    assert len(chain) > 3  # a larger overlap costs views


def test_the_plan_shows_the_part_and_can_be_taken(tmp_path):
    path = plan_file(tmp_path, part_alone, "part.yaml")
    asked = ["plan", "design", str(path), "--part", "--out", str(tmp_path / "new.yaml"), "--json"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["covered"] >= OPTIONS.coverage
    new = load(tmp_path / "new.yaml")
    views = new.plan.steps[0].views
    assert len(views) == said["views"] < 15
    # Points and rays of another seed find the same surface covered.
    found = part_coverage.part_views(new, "part", None, 40.0, 7, replace(OPTIONS, part_views=200))
    mesh = new.cell.artefact("freeform").mesh
    points, normals = part_coverage._samples(mesh, OPTIONS.surface_points, np.random.default_rng(7))
    place, depth = new.cell.station("part").planned_pose, part_coverage.aim_depth(new.plan.scanner.field_of_view)
    T = np.stack([part_coverage.T_base_scanner(place, np.array(v.at_mm), v, depth) for v in views])
    shown = part_coverage._shown(new, mesh, points, normals, se3.inverse(T) @ place, OPTIONS).any(axis=0)
    seen_at_all = found.shown.any(axis=0)
    assert (shown & seen_at_all).sum() > 0.95 * seen_at_all.sum()
    assert "exists already" in CliRunner().invoke(app, asked).stderr


def test_a_plan_without_a_part_says_what_to_add():
    with pytest.raises(ConfigError, match="scans no part; add a step with `do: scan`"):
        part_coverage.design_part(load(PLANS / "quick.yaml"), None, 40.0, 0)


def test_a_part_of_a_box_alone_needs_a_mesh():
    loaded = load(PLANS / "part.yaml")
    boxed = tuple(replace(a, mesh=None) if a.is_part else a for a in loaded.cell.artefacts)
    with pytest.raises(ConfigError, match="known by its box alone; give the mesh"):
        part_coverage.design_part(replace(loaded, cell=replace(loaded.cell, artefacts=boxed)), None, 40.0, 0)
