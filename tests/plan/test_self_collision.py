"""The arm against itself: which pairs of its bodies are examined, and what is found."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import yaml
from plan_folder import PLANS

from mbcacq.plan import load
from mbcacq.plan.clearance import Clearance, EnclosingSpheres, Posture
from mbcacq.plan.collision import arm_bodies, halves

ROBOTS = {"kr10_r1100_2": [0, -90, 90, 0, 90, 0], "kr210_r2700_2": [0, -90, 90, 0, 90, 0], "panda": [0, 0, 0, -100, 0, 100, 0]}
HELD_OUT = ((-20.0, -20.0, 60.0), (20.0, 20.0, 100.0))  # a small housing 165 mm from the flange, so that a bracket carries it


def planned(tmp_path, robot, body_mm=None):
    plan = yaml.safe_load((PLANS / "kuka.yaml").read_text())
    plan["robot"] |= {"model": str(PLANS / "robots" / f"{robot}.yaml"), "home_deg": ROBOTS[robot]}
    plan["artefacts"] = [str(PLANS / name) for name in plan["artefacts"]]
    plan["scanner"]["field_of_view"]["body_mm"] = body_mm or plan["scanner"]["field_of_view"]["body_mm"]
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False))
    return load(path)


@pytest.mark.parametrize(("robot", "wrist_deg"), [("kr10_r1100_2", 113.0), ("kr210_r2700_2", 118.0)])
def test_a_bracket_that_begins_beside_the_forearm_is_found_when_it_is_folded_onto_it(tmp_path, robot, wrist_deg):
    """The bracket's beginning overlaps with the forearm's end in every posture, its end does not."""
    loaded = planned(tmp_path, robot, HELD_OUT)
    clearance = Clearance(loaded)
    assert clearance.at(np.radians(ROBOTS[robot]), None).distance > loaded.plan.clearance_mm
    found = clearance.at(np.radians([-40, -72, -115, -2, wrist_deg, -150]), None)
    assert {found.a, found.b} == {"link 4", "bracket"}
    assert found.distance < loaded.plan.clearance_mm
    folding = clearance.along_segment(np.radians(ROBOTS[robot]), np.radians([-40, -72, -115, -2, wrist_deg, -150]), None, 10.0)
    assert folding is not None


def test_two_links_of_a_panda_that_are_near_in_every_posture_are_found_to_touch(tmp_path):
    """Links 3 and 5 are never farther apart than 4 mm: only a short link lies between them."""
    clearance = Clearance(planned(tmp_path, "panda"))
    bent = clearance.at(np.radians(ROBOTS["panda"]), None)
    assert bent.distance > 10
    stretched = clearance.at(np.radians([0, 0, 0, -60, 0, 60, 0]), None)
    assert {stretched.a, stretched.b} == {"link 3", "link 5"}
    assert stretched.distance < 0


@pytest.mark.parametrize("robot", ROBOTS)
def test_only_neighbours_and_what_always_overlaps_is_left_out(tmp_path, robot):
    loaded = planned(tmp_path, robot)
    clearance, limits = Clearance(loaded), loaded.cell.robot.limits
    examined = {(p.a, p.b) for p in clearance.pairs(None)}
    q = np.random.default_rng(3).uniform(limits[:, 0], limits[:, 1], (60, len(limits)))
    postures = [Posture(frames) for frames in loaded.cell.robot.chain.frames(q)]
    left_out = [(a, b) for a, b in combinations(clearance._arm, 2) if b.link > max(a.link, 1) and (a, b) not in examined]
    assert 0 < len(left_out) < len(examined)
    for a, b in left_out:
        farthest = max(posture.distance(clearance._pair(a, b)) for posture in postures)
        assert farthest <= 0 or (b.link - a.link == 1 and farthest <= 10), (a.name, b.name)


def test_halves_of_a_body_cover_it(tmp_path):
    """The distance of a body to any other is that of its nearer half."""
    loaded = planned(tmp_path, "kr10_r1100_2", HELD_OUT)
    clearance = Clearance(loaded)
    forearm, *carried = (body for body in arm_bodies(loaded) if body.name == "link 4" or body.carried)
    assert {body.name for body in carried} == {"scanner", "bracket"}
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (30, 6))
    for posture in (Posture(frames) for frames in loaded.cell.robot.chain.frames(q)):
        for body in carried:
            whole = posture.distance(clearance._pair(forearm, body))
            parts = [posture.distance(clearance._pair(forearm, half)) for half in halves(body)]
            assert min(parts) == pytest.approx(whole, abs=1e-3) if whole > 0 else min(parts) < 0.1
            assert all(half.length == pytest.approx(body.length / 2) for half in halves(body)) or body.name == "scanner"


def test_more_clearance_than_two_bodies_can_have_is_not_asked_of_them(tmp_path):
    loaded = planned(tmp_path, "panda")
    demanding = replace(loaded, plan=loaded.plan.model_copy(update={"clearance_mm": 30.0}))
    near = [p for p in Clearance(demanding).pairs(None) if np.isfinite(p.most)]
    assert ("link 5", "link 7") in {(p.a.name, p.b.name) for p in near}
    assert all(0 < p.most <= 15 for p in near)
    assert Clearance(demanding).at(np.radians(ROBOTS["panda"]), None).distance > 30


@pytest.mark.parametrize("robot", ROBOTS)
def test_spheres_around_two_bodies_are_never_farther_apart_than_the_bodies(tmp_path, robot):
    """Pairs are skipped by the spheres, so a gap that is too large would hide a contact; overlaps count as negative distances."""
    loaded = planned(tmp_path, robot, HELD_OUT)
    arm, pairs = loaded.cell.robot, Clearance(loaded).pairs("p1")
    q = np.random.default_rng(8).uniform(arm.limits[:, 0], arm.limits[:, 1], (40, arm.n))
    frames = arm.chain.frames(q)
    distances = np.array([[Posture(f).distance(pair) for pair in pairs] for f in frames])
    assert np.all(EnclosingSpheres(pairs).gaps(frames) <= distances + 1e-6)
    assert distances.min() < 0


def test_an_arm_without_pairs_to_examine_is_free_everywhere(tmp_path, monkeypatch):
    monkeypatch.setattr(Clearance, "_own_pairs", lambda self: [])
    monkeypatch.setattr(Clearance, "_against", lambda self, body: [])
    clearance = Clearance(planned(tmp_path, "panda"))
    home = np.radians(ROBOTS["panda"])
    assert clearance.at(home, None).distance == np.inf
    assert clearance.along_segment(home, home + 0.5, None, 10.0) is None
