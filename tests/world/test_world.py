"""The composed world: what stands where, what repeats, what goes wrong."""

import numpy as np
import pytest
from mbcacq_fakes.cell.build_world import make_camera, make_world
from mbcacq_fakes.world.hooks import NoEffect
from mbcacq_fakes.world.options import FakeOptions, Mishap, parse
from mbcacq_fakes.world.rigid import carry, invert
from mbcacq_fakes.world.world import World
from small_cell import POSE_STATION, Arm, fit_sphere, poses_q

from mbcacq.errors import ConfigError


def moments(world, q, arrival, station=0):
    p = len(q)
    zero = np.zeros((p, 6))
    return world.moments(
        np.asarray(q),
        zero,
        zero,
        np.asarray(arrival),
        10.0 * np.asarray(arrival),
        np.full(p, station),
        world.facts.station_artefact[np.full(p, station)],
    )


def balls(world, q, arrival, station=0):
    at = moments(world, q, arrival, station)
    return world.balls_in_scanner(at, world.displaced(at), int(at.artefact[0]))


def camera_and_arm(cell_facts, **fake):
    options = FakeOptions(**fake)
    world = make_world(cell_facts, options, 3)
    arm = Arm(poses_q()[0])
    return make_camera(world, arm, options, poses_q(), POSE_STATION), arm


def test_repeatability_is_drawn_per_arrival_and_moves_all_balls_together(cell_facts, deviations):
    world = World(cell_facts, deviations, seed=3)
    q = np.tile(poses_q()[0], (40, 1))
    centres = balls(world, q, np.repeat(np.arange(20), 2))
    np.testing.assert_array_equal(centres[0::2], centres[1::2])  # two exposures at one standstill
    assert np.all(np.linalg.norm(np.diff(centres[0::2], axis=0), axis=2) > 1e-6)
    distances = np.linalg.norm(centres[:, :, None] - centres[:, None], axis=3)
    np.testing.assert_allclose(distances, np.broadcast_to(distances[0], distances.shape), atol=1e-9)


def test_repeatability_has_the_stated_size(cell_facts, deviations):
    draws = World(cell_facts, deviations, seed=1).repeatability(np.arange(4000))
    np.testing.assert_allclose(draws.std(axis=0), 5e-6, rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(draws.T) - np.eye(6), 0, atol=0.07)


def test_same_seed_same_world_and_other_seed_another(cell_facts, deviations):
    one, same, other = (World(cell_facts, deviations, seed=s) for s in (4, 4, 5))
    np.testing.assert_array_equal(one.stations, same.stations)
    np.testing.assert_array_equal(one.hand_eye, same.hand_eye)
    assert np.all(np.abs(one.stations[:, :3, 3] - other.stations[:, :3, 3]).max(axis=1) > 1e-3)


def test_another_noise_seed_is_another_run_of_the_same_cell(cell_facts):
    fake = {"seed": 4, "errors": "random", "hidden": [{"name": "joint_compliance", "where": "A2"}]}
    one, same, other = (make_world(cell_facts, parse({**fake, **more}), 0) for more in ({}, {"noise_seed": 4}, {"noise_seed": 5}))
    frames = [make_camera(w, Arm(poses_q()[0]), FakeOptions(), poses_q(), POSE_STATION)().xyz for w in (one, same, other)]
    for world in (same, other):
        assert repr(world.truth()) == repr(one.truth())
    np.testing.assert_array_equal(same.repeatability(np.arange(5)), one.repeatability(np.arange(5)))
    np.testing.assert_array_equal(frames[1], frames[0])
    assert not np.any(other.repeatability(np.arange(5)) == one.repeatability(np.arange(5)))
    assert not np.array_equal(frames[2], frames[0], equal_nan=True)


def test_true_places_lie_near_the_plan_but_not_on_it(cell_facts, deviations):
    shifts, turns = [], []
    for seed in range(60):
        world = World(cell_facts, deviations, seed=seed)
        off = invert(cell_facts.station_pose) @ world.stations
        shifts.append(off[:, :3, 3])
        turns.append(np.arccos((np.trace(off[:, :3, :3], axis1=1, axis2=2) - 1) / 2))
    assert 1.0 < np.std(shifts) < 1.6  # 1.5 mm, cut at 2 sigma
    assert np.max(np.abs(shifts)) <= 3.0 + 1e-9
    assert 0.2 < np.degrees(np.mean(turns)) < 1.0


def test_rendered_balls_stand_where_the_true_arm_says(cell_facts):
    """The true geometry, written out here from the truth alone, against spheres fitted to the rendered frame."""
    camera, arm = camera_and_arm(cell_facts, repeatability_urad=0.0)
    truth = camera.world.truth()
    T_base_scanner = camera.world.arm.flange(np.array([arm.reading.q]))[0] @ truth["T_flange_scanner"]
    expected = carry(invert(T_base_scanner) @ truth["T_base_station"]["1"], np.array([truth["balls"][b] for b in range(1, 9)]))
    mean = np.zeros((8, 3))
    for _ in range(10):
        xyz = camera(0.0).xyz.reshape(-1, 3).astype(float)
        xyz = xyz[np.isfinite(xyz[:, 2])]
        mean += [fit_sphere(xyz[np.linalg.norm(xyz - c, axis=1) < 6.3], 6.0)[0] / 10 for c in expected]
    assert np.all(np.abs(mean - expected) < 4.5 * np.array([0.005, 0.005, 0.009]) / np.sqrt(10))


def test_effects_act_where_they_say(cell_facts, deviations):
    class Bent(NoEffect):
        name = "bent"

        def displace(self, at, moved):
            moved.joint[:, 1] += 1e-3
            moved.ball[:, 2, 0] += 0.1

        def warp(self, points, pose, at):
            return points * 1.001

    straight, bent = World(cell_facts, deviations, seed=3), World(cell_facts, deviations, [Bent()], seed=3)
    q = poses_q()[:1]
    turned = q + np.array([[0, 1e-3, 0, 0, 0, 0]])
    rigid = np.delete(np.arange(8), 2)
    np.testing.assert_allclose(balls(bent, q, [0])[0, rigid], balls(straight, turned, [0])[0, rigid], atol=1e-9)
    lost = np.linalg.norm(balls(bent, q, [0])[0, 2] - balls(straight, turned, [0])[0, 2])
    assert lost == pytest.approx(0.1, abs=1e-9)
    at = moments(bent, q, [0])
    np.testing.assert_allclose(bent.warp(np.array([[10.0, 0, 0]]), np.array([0]), at), [[10.01, 0, 0]])


def test_the_operator_follows_the_plan(cell_facts):
    camera, arm = camera_and_arm(cell_facts)
    for k, q in enumerate(poses_q()):
        arm.go(q + 1e-4)
        at = camera.moment(arm.read())
        assert at.station[0] == POSE_STATION[k]
        assert at.artefact[0] == (1 if k == 5 else 0)


def test_equal_poses_at_two_stations_are_served_in_the_plans_order(cell_facts):
    from mbcacq_fakes.world.operator import FakeOperator

    a, b = poses_q()[:2]
    operator = FakeOperator(np.array([a, b, a, b]), np.array([0, 0, 1, 1]), cell_facts.station_artefact)
    assert [operator.station_for(q) for q in (a, a, b, a, a, b)] == [0, 0, 0, 1, 1, 1]


def test_a_positioner_overrules_the_operator(cell_facts):
    camera, arm = camera_and_arm(cell_facts)
    camera.follow(lambda: 2)
    assert camera.moment(arm.read()).station[0] == 2


def count(frame):
    return int(np.isfinite(frame.xyz[..., 2]).sum())


def test_mishaps(cell_facts):
    camera, _ = camera_and_arm(cell_facts, furniture=False)
    clean = count(camera())
    camera.mishap(Mishap(kind="hidden_ball", ball=3))
    assert count(camera()) == pytest.approx(clean * 7 / 8, rel=0.05)
    camera.mishap(Mishap(kind="wrong_artefact", station=1, artefact="bar"))
    spread = camera().xyz[..., 2]
    assert np.nanmax(spread) > 10  # the 25 mm balls stand higher than the eight small ones
    camera.mishap(Mishap(kind="empty_scene"))
    assert count(camera()) == 0


def test_a_bump_comes_when_it_comes_and_moves_the_artefact_rigidly(cell_facts):
    """The tripod is bumped by 0.4 mm at the third arrival; centres before and after differ by just that."""
    camera, arm = camera_and_arm(
        cell_facts,
        noise_mm=(0, 0, 0),
        speckle_mm=0.0,
        repeatability_urad=0.0,
        mishaps=[{"kind": "bumped_tripod", "station": 1, "shift_mm": (0.4, 0, 0), "from_arrival": 3}],
    )
    found = []
    for _ in range(5):
        at = camera.moment(arm.read())
        expected = camera.world.balls_in_scanner(at, camera.world.displaced(at), 0)[0]
        xyz = camera().xyz.reshape(-1, 3).astype(float)
        found.append([fit_sphere(xyz[np.linalg.norm(xyz - c, axis=1) < 6.2], 6.0)[0] for c in expected])
        arm.go(arm.reading.q)
    step = np.linalg.norm(np.diff(np.mean(found, axis=1), axis=0), axis=1)
    np.testing.assert_allclose(step, [0, 0, 0.4, 0], atol=0.002)


@pytest.mark.parametrize(
    ("fake", "words"),
    [
        ({"erors": "paper"}, "erors"),
        ({"pitch_mm": -1}, "pitch_mm"),
        ({"errors": [[0, 0, 0, 0, 0]]}, "1 rows, but the arm has 6"),
        ({"mishaps": [{"kind": "hidden_ball", "ball": 77}]}, "no ball '77'"),
    ],
)
def test_wrong_options_are_one_sentence(cell_facts, fake, words):
    def build():
        options = parse(fake)
        make_camera(make_world(cell_facts, options, 0), Arm(poses_q()[0]), options, poses_q(), POSE_STATION)

    with pytest.raises(ConfigError, match=words):
        build()


def test_the_scanner_s_housing_warms_up_faster_and_further_than_the_arm():
    from mbcacq_fakes.world.environment import Environment

    climate, time_s = Environment(), np.array([0.0, 600.0, 3600.0, 36000.0])
    above = climate.scanner(time_s) - climate.air(time_s)
    assert above[0] == 0
    assert (above[1:] > (climate.robot(time_s) - climate.air(time_s))[1:]).all()
    assert above[-1] == pytest.approx(14.0, abs=1e-3)
