"""The orientation of a target, misread by the direction from which a camera sees it, in a cell that shares no code with the tool."""

import independent_cell as plain
import numpy as np
import pytest
from independent_cell import pose, rotation

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.effects.context import Context
from mbcacq.effects.described import parts_of
from mbcacq.effects.kinds import orientation_bias
from mbcacq.estimation import forward_model, terms
from mbcacq.estimation.forward_model import CellState
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations

T_FLANGE_TARGET = pose(rotation(np.array([0.3, -0.2, 0.5])), np.array([20.0, -35.0, 90.0]))
T_BASE_TRACKER = pose(rotation(np.array([0.05, -0.1, 2.0])), np.array([2600.0, -900.0, 400.0]))
LINEAR = np.array([[2e-5, 0, 0], [0, -3e-5, 0], [1e-5, 0, 2e-5]])  # rad: about x, y, z of the target by the line of sight


def seen(count: int, seed: int, misread, noise: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Observations:
    """Poses at which the target is measured. misread: line of sight (3,) in the target's axes -> rotation vector (3,) by which the measured
    target is turned about its own axes. noise: standard deviations of a coordinate (mm), of a joint and of the orientation (rad).
    """
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.radians([-60, -120, 30, -120, -90, -170]), np.radians([60, -40, 130, 120, 90, 170]), (count, 6))
    xyz, turned = np.zeros((count, 3)), np.zeros((count, 3, 3))
    to_tracker = np.linalg.inv(T_BASE_TRACKER)
    for j, angles in enumerate(q):
        T = to_tracker @ plain.frames(angles + rng.normal(0, noise[1], 6))[-1] @ T_FLANGE_TARGET
        line = T[:3, :3].T @ (T[:3, 3] / np.linalg.norm(T[:3, 3]))
        xyz[j] = T[:3, 3] + rng.normal(0, noise[0], 3)
        turned[j] = T[:3, :3] @ rotation(np.asarray(misread(line), dtype=float) + rng.normal(0, noise[2], 3))
    target = Artefact("target", "target", (1,), np.zeros((1, 3)), np.ones(1))
    cell = Cell(robot(), T_FLANGE_TARGET, (target,), (Station("1", "target"),), "tracker", np.full(3, 0.02), measurement=TARGET_IN_BASE)
    each = np.arange(count)
    return Observations(cell, each, np.zeros(count, int), q, each, np.zeros(count, int), xyz, rotation=turned)


def robot() -> RobotModel:
    chain = Chain(plain.SIGN, plain.THETA, plain.D, plain.A, plain.ALPHA, np.zeros(6))
    return RobotModel("independent arm", chain, np.radians([[-350.0, 350.0]] * 6), plain.MASS, plain.COM, repeatability_mm=0.08)


def context(obs: Observations) -> Context:
    state = CellState(obs.cell.robot.chain, T_FLANGE_TARGET, T_BASE_TRACKER[None], np.zeros((1, 3)))
    return Context(obs, state, forward_model.predict(obs, state))


def by_camera(line: np.ndarray) -> np.ndarray:
    """Errors of a camera that sees the target's markers foreshortened: by azimuth and elevation of the line of sight, not a polynomial."""
    azimuth, elevation = np.arctan2(line[0], line[2]), np.arcsin(np.clip(line[1], -1, 1))
    return 4e-4 * np.array([np.cos(azimuth) * elevation, np.sin(azimuth), 0.5 * np.sin(2 * elevation)])


@pytest.mark.parametrize("variant", ["linear", ""])
def test_parameters_are_the_turns_about_the_targets_axes(variant):
    obs = seen(40, 1, lambda line: LINEAR @ line)
    here = context(obs)
    candidate = next(c for c in orientation_bias.candidates(here) if c.variant == variant)

    X = terms.columns(obs, here.prediction, terms.term(candidate.name, parts_of(candidate, here)))
    moved = forward_model.residual(obs, here.prediction)
    found = np.linalg.lstsq(X.reshape(-1, candidate.k), moved.ravel())[0]

    np.testing.assert_allclose(moved[:, :3], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.reshape(3, -1)[:, :3], LINEAR, atol=1e-9)
    to_tracker = np.linalg.inv(T_BASE_TRACKER)
    seen_from = [(to_tracker @ plain.frames(q)[-1] @ T_FLANGE_TARGET) for q in obs.q]
    turns = np.array([LINEAR @ T[:3, :3].T @ (T[:3, 3] / np.linalg.norm(T[:3, 3])) for T in seen_from])
    reported = candidate.parameters(found, 1e-16 * np.eye(candidate.k), None)
    for axis, size in zip("xyz", turns.std(axis=0), strict=True):
        assert reported[f"about_{axis}_rad"].value == pytest.approx(size, rel=1e-3)


def test_a_prediction_with_the_effect_is_what_is_measured():
    obs = seen(30, 2, lambda line: LINEAR @ line)
    here = context(obs)
    candidate = next(c for c in orientation_bias.candidates(here) if c.variant == "linear")

    moved = terms.accumulate(obs, [terms.term(candidate.name, parts_of(candidate, here))], [LINEAR.ravel()])
    left = forward_model.residual(obs, forward_model.predict(obs, here.state, moved))

    np.testing.assert_allclose(left, 0.0, atol=1e-8)


def test_a_camera_that_misreads_a_leaning_target_is_named():
    obs = seen(150, 3, by_camera, noise=(0.02, 2e-5, 3e-5))

    found = diagnose(obs, folds=2)

    assert [(e.name, e.where) for e in found.effects] == [("orientation_bias", ("target",))]
    assert found.verdict == "explained"


def test_a_true_orientation_is_not_suspected():
    found = diagnose(seen(150, 4, lambda line: np.zeros(3), noise=(0.02, 2e-5, 3e-5)), folds=2)

    assert not found.effects
    assert found.verdict == "none"
