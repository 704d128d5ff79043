"""All scans of one part registered at once, of shapes and from places that are known."""

from dataclasses import replace

import numpy as np
import part_shapes
import pytest
from scipy.stats import chi2

from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell, Station
from mbcacq.model.observations import Observations
from mbcacq.parts.observations import observations_of_parts
from mbcacq.parts.options import PartOptions
from mbcacq.parts.scans import PartScan, surface_of
from mbcacq.parts.scene import register
from mbcacq.plan.loader import load


def seen(shape, count, off_mm, off_rad, seed):
    """A registered scene, and where its part truly was before the scanner (N, 4, 4)."""
    rng = np.random.default_rng(seed)
    triangles = part_shapes.height_field(part_shapes.SHAPES[shape])
    views = [part_shapes.look(*rng.uniform([5, 0, -90], [28, 360, 90]), shift_mm=rng.uniform(-15, 15, 2)) for _ in range(count)]
    surfaces = [surface_of(PartScan(k, np.zeros(6), part_shapes.scan(rng, triangles, T))) for k, T in enumerate(views)]
    twists = np.concatenate([rng.normal(0, off_mm, (count, 3)), rng.normal(0, off_rad, (count, 3))], axis=1)
    return register(surfaces, se3.exp(twists) @ np.array(views), PartOptions()), se3.inverse(np.array(views))


def errors(scene, true):
    """Pose errors (6 N,) once the place of the scene in the part is fitted, their covariance, and the number of their degrees of freedom."""
    count = len(true)
    C = scene.shared.reshape(6 * count, -1) @ scene.shared.reshape(6 * count, -1).T
    for k, own in enumerate(scene.covariance):
        C[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += own
    W, place = np.linalg.inv(C), se3.inverse(true[0]) @ scene.T_scanner_scene[0]
    for _ in range(3):
        expected = true @ place
        turn = se3.rotation_log(scene.T_scanner_scene[:, :3, :3] @ np.swapaxes(expected[:, :3, :3], 1, 2))
        e = np.concatenate([scene.T_scanner_scene[:, :3, 3] - expected[:, :3, 3], turn], axis=1).reshape(-1)
        J = np.concatenate([np.kron(np.eye(2), R) for R in expected[:, :3, :3]])
        step = np.linalg.solve(J.T @ W @ J, J.T @ W @ e)
        place = place @ se3.exp(step)
    open_ = int((np.abs(scene.shared).max(axis=(0, 1)) > 1).sum())
    return e - J @ step, C, 6 * count - 6 - open_


def test_scans_come_together_as_well_as_their_covariance_says():
    scene, true = seen("casting", 8, 2.0, 0.01, 5)  # two millimetres off, as before any calibration
    e, C, degrees = errors(scene, true)
    assert not scene.left_out
    assert degrees == 42
    assert np.sqrt(np.mean(e.reshape(-1, 6)[:, :3] ** 2)) < 0.015
    assert chi2.ppf(0.001, degrees) < e @ np.linalg.solve(C, e) < chi2.ppf(0.999, degrees)


def test_a_turn_that_no_scan_shows_is_left_open():
    scene, true = seen("turned", 6, 0.05, 3e-4, 1)
    assert (np.abs(scene.shared).max(axis=(0, 1)) > 1).sum() >= 6  # about the axis of the part, of each scan
    e, C, degrees = errors(scene, true)
    assert e @ np.linalg.solve(C, e) < chi2.ppf(0.999, degrees + 1)
    axis = np.einsum("nij,j->ni", true[:, :3, :3], [0.0, 0.0, 1.0])  # in the scanner
    turn = np.einsum("ni,nik->nk", axis, scene.shared[:, 3:])
    assert np.all(np.abs(turn).max(axis=1) > 1)


@pytest.fixture(scope="module")
def one_scene():
    scene, _ = seen("casting", 4, 0.05, 3e-4, 2)
    return scene


def test_derivatives_are_those_of_finite_differences(one_scene):
    """By the arm's parameters, the hand-eye and the place of the scene: rows of position and rotation vector."""
    from dry_runs import PLANS

    cell: Cell = load(PLANS / "kuka.yaml").cell
    cell = replace(cell, stations=(Station("s", cell.artefacts[0].id),))
    q = np.radians([[10, -80, 95, 5, 60, 20], [-5, -70, 85, -10, 70, -30], [0, -85, 100, 15, 65, 80], [20, -75, 90, -5, 55, 0]])
    none = {"pose": np.zeros(0, int), "ball": np.zeros(0, int), "xyz": np.zeros((0, 3))}
    empty = Observations(cell=cell, pose_id=np.arange(4), station=np.zeros(4, int), q=q, **none)
    obs = observations_of_parts(empty, {"s": (one_scene, np.arange(4))})
    X, S = cell.T_flange_scanner, se3.transform(np.eye(3), np.array([600.0, 20.0, 80.0]))
    state = CellState(cell.robot.chain, X, S[None], obs.cell.ball_centres)
    at = forward_model.predict(obs, state)
    turn = se3.rotation_exp(np.full(3, 1e-3))
    obs = replace(obs, xyz=at.xyz + 0.01, rotation=turn @ at.rotation)

    def rows(state):
        return forward_model.residual(obs, forward_model.predict(obs, state))

    h = 1e-6
    mount = at.by_twists(np.swapaxes(se3.adjoint(at.T_base_scanner), 1, 2))
    place = at.by_twists(np.swapaxes(-se3.adjoint(at.T_base_station), 1, 2))
    links = at.by_twists(cell.robot.chain.parameter_twists(at.frames, q).reshape(4, -1, 6))
    for k, unit in enumerate(np.eye(6) * h):
        hand_eye = (
            rows(replace(state, T_flange_scanner=X @ se3.exp(-unit))) - rows(replace(state, T_flange_scanner=X @ se3.exp(unit)))
        ) / 2
        assert hand_eye / h == pytest.approx(mount[:, :, k], abs=2e-3)
        moved = (
            rows(replace(state, T_base_station=S[None] @ se3.exp(-unit))) - rows(replace(state, T_base_station=S[None] @ se3.exp(unit)))
        ) / 2
        assert moved / h == pytest.approx(place[:, :, k], abs=2e-3)
    for k in range(links.shape[2]):
        error = np.zeros(links.shape[2])
        error[k] = h
        off = [rows(replace(state, chain=cell.robot.chain.with_errors(s * error.reshape(-1, 5)))) for s in (-1, 1)]
        assert (off[0] - off[1]) / (2 * h) == pytest.approx(links[:, :, k], abs=2e-3 * max(1, np.abs(links[:, :, k]).max()))
