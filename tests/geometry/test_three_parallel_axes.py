"""Closed form of arms with three parallel axes: every posture comes back, and the numerical solver knows no other branch."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from mbcacq.geometry.chain import Chain
from mbcacq.geometry.numerical_inverse import NumericalInverse
from mbcacq.geometry.three_parallel_axes import ThreeParallelAxesInverse
from mbcacq.model.cell_schema import RobotSpec

TURN = np.tile([-2 * np.pi, 2 * np.pi], (6, 1))
ONCE = np.tile([-np.pi, np.pi], (6, 1))


ROBOTS = Path(__file__).parents[2] / "plans" / "robots"


def shipped(name):
    return RobotSpec.model_validate(yaml.safe_load((ROBOTS / f"{name}.yaml").read_text())).model()


def of_the_family(seed):
    """Any lengths, offsets of the zeros and directions of turning; an offset between axes 1 and 2, and between 4 and 5."""
    rng = np.random.default_rng(seed)
    length = rng.uniform(50, 700, 12)
    return Chain(
        sign=rng.choice([-1.0, 1.0], 6),
        theta=rng.uniform(-np.pi, np.pi, 6),
        d=np.array([length[0], length[1], -length[2], length[3], length[4], length[5]]),
        a=np.array([length[6], length[7], length[8], length[9], 0.0, length[10]]),
        alpha=np.array([np.pi / 2, 0.0, 0.0, -np.pi / 2, np.pi / 2, rng.uniform(-3, 3)]),
        beta=np.zeros(6),
    )


@pytest.mark.parametrize("chain", [shipped("ur10e").chain, shipped("ur10").chain, *(of_the_family(k) for k in range(6))])
def test_every_posture_comes_back_and_every_answer_leads_to_its_pose(chain):
    q = np.random.default_rng(1).uniform(*TURN.T, (100, 6))
    T = chain.flange(q)
    for posture, pose, found in zip(q, T, ThreeParallelAxesInverse.of(chain, TURN).solutions(T), strict=True):
        assert np.abs(found - posture).max(axis=1).min() < 1e-6
        np.testing.assert_allclose(chain.flange(found), np.broadcast_to(pose, (len(found), 4, 4)), atol=1e-6)
        assert len(np.unique(found.round(7), axis=0)) == len(found)


@pytest.mark.parametrize("chain", [shipped("ur10e").chain, of_the_family(1), of_the_family(2)])
def test_it_has_the_branches_that_the_numerical_solver_finds(chain):
    T = chain.flange(np.random.default_rng(2).uniform(*ONCE.T, (25, 6)))
    closed = ThreeParallelAxesInverse.of(chain, ONCE).solutions(T)
    for here, there in zip(closed, NumericalInverse(chain, ONCE).branches(T), strict=True):
        assert len(there) > 0
        for q in there:
            away = np.mod(here - q + np.pi, 2 * np.pi) - np.pi
            assert np.abs(away).max(axis=1).min() < 1e-5


def test_a_pose_out_of_reach_has_none_and_limits_hold():
    arm = shipped("ur10e")
    solver = ThreeParallelAxesInverse.of(arm.chain, arm.limits)
    far = arm.chain.flange(np.zeros((1, 6)))
    far[0, :3, 3] *= 3
    assert len(solver.solutions(far)[0]) == 0
    narrow = np.tile([-1.0, 1.0], (6, 1))
    q = np.random.default_rng(3).uniform(-0.9, 0.9, (50, 6))
    for found in ThreeParallelAxesInverse.of(arm.chain, narrow).solutions(arm.chain.flange(q), margin=0.05):
        assert np.all(np.abs(found) <= 0.95)


def test_the_nearest_is_on_the_branch_that_was_asked_for():
    arm = shipped("ur10e")
    solver = ThreeParallelAxesInverse.of(arm.chain, arm.limits)
    for q in np.random.default_rng(4).uniform(-3, 3, (20, 6)):
        np.testing.assert_allclose(solver.nearest(arm.chain.flange(q[None])[0], q + 0.01), q, atol=1e-7)


@pytest.mark.parametrize("name", ["kr10_r1100_2", "crx10ia", "panda", "iiwa14"])
def test_arms_of_other_families_are_left_to_other_solvers(name):
    arm = shipped(name)
    assert ThreeParallelAxesInverse.of(arm.chain, arm.limits) is None


def test_an_arm_with_link_errors_is_not_of_the_family():
    chain = shipped("ur10e").chain
    errors = np.zeros((6, 5))
    errors[1, 4] = 1e-4
    assert ThreeParallelAxesInverse.of(chain.with_errors(errors), TURN) is None
