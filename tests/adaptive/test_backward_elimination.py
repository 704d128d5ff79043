"""Backward elimination by rank updates agrees with the normal equations of the poses that are left."""

import numpy as np
import pytest

from mbcacq.design.adaptive.backward_elimination import BackwardElimination, MeasuredInformation
from mbcacq.design.information_blocks import InformationBlocks

POSES, ROWS, G, K, PAIRS = 12, 4, 9, 5, 2


def blocks(seed: int) -> InformationBlocks:
    rng = np.random.default_rng(seed)
    return InformationBlocks(rng.normal(size=(POSES, ROWS, G)), rng.normal(size=(POSES, ROWS, K)))


def beyond_the_geometry(before: InformationBlocks, left: InformationBlocks) -> np.ndarray:
    """E'M E, M the projector of weighted least squares with a prior of one, written out."""
    Z = np.concatenate([b.Z.reshape(-1, G) for b in (before, left)])
    E = np.concatenate([b.E.reshape(-1, K) for b in (before, left)])
    return E.T @ (np.eye(len(Z)) - Z @ np.linalg.inv(np.eye(G) + Z.T @ Z) @ Z.T) @ E


@pytest.fixture
def elimination():
    return BackwardElimination(MeasuredInformation.nothing(G, K).with_poses(blocks(1)), blocks(2), PAIRS)


def test_what_each_pose_is_missed_by_is_what_leaving_it_out_loses(elimination):
    for gone in (3, 7, 0, 11, 5):
        index, products, squares = elimination.missed()
        k = int(np.flatnonzero(index == gone)[0])
        expected = elimination.products - products[k], elimination.squares - squares[k]
        elimination.remove(gone)
        exact = beyond_the_geometry(blocks(1), blocks(2).select(np.flatnonzero(elimination.left)))
        assert elimination.products == pytest.approx(exact[:PAIRS, :PAIRS], rel=1e-6)
        assert elimination.squares == pytest.approx(np.diag(exact), rel=1e-6)
        assert expected[0] == pytest.approx(elimination.products, rel=1e-6)
        assert expected[1] == pytest.approx(elimination.squares, rel=1e-6)


def test_the_poses_that_are_left_are_the_best_pair_of_a_station_that_growing_would_never_open():
    """Two poses of one unknown place see a length together, and neither alone: a third, of a known place, sees a little of it."""
    Z, E = np.zeros((3, 1, 1)), np.zeros((3, 1, 1))
    Z[0], Z[1], E[0], E[1], E[2] = 100.0, 100.0, 30.0, -30.0, 3.0
    data = InformationBlocks(Z, E)
    start = MeasuredInformation.nothing(1, 1)
    alone = [float(start.with_poses(data.select(np.array([k]))).squares[0]) for k in range(3)]
    elimination = BackwardElimination(start, data, 0)
    index, _, missed = elimination.missed()
    elimination.remove(int(index[np.argmin(missed[:, 0])]))
    assert int(np.argmax(alone)) == 2
    assert list(elimination) == [0, 1]


def test_the_parameters_of_one_station_say_all_that_its_poses_do():
    """Poses of two stations, each with six parameters of its own beside three that are shared: the other station's may be eliminated."""
    rng, g = np.random.default_rng(3), 3
    Z = np.zeros((8, ROWS, g + 12))
    Z[:, :, :g] = rng.normal(size=(8, ROWS, g))
    Z[:5, :, g : g + 6], Z[5:, :, g + 6 :] = rng.normal(size=(5, ROWS, 6)), rng.normal(size=(3, ROWS, 6))
    data = InformationBlocks(Z, rng.normal(size=(8, ROWS, K)))
    before = MeasuredInformation.nothing(g + 12, K).with_poses(data.select(np.arange(3, 8)))
    ahead, block = data.select(np.arange(3)), slice(g, g + 6)
    alone = InformationBlocks(np.concatenate([ahead.Z[:, :, :g], ahead.Z[:, :, block]], axis=2), ahead.E)
    assert before.of_block(g, block).gram == pytest.approx(before.gram)
    assert before.of_block(g, block).with_poses(alone).gram == pytest.approx(before.with_poses(ahead).gram)
    J = np.pad(rng.normal(size=(2, g)), ((0, 0), (0, 12)))
    assert before.of_block(g, block).variance(J[:, : g + 6]) == pytest.approx(before.variance(J))


def test_the_variance_without_a_pose_is_that_of_the_poses_that_are_left(elimination):
    J = np.random.default_rng(5).normal(size=(2, G))
    elimination.remove(4)
    index, without = np.flatnonzero(elimination.left), elimination.variance_without(J)
    elimination.remove(int(index[2]))
    left = MeasuredInformation.nothing(G, K).with_poses(blocks(1)).with_poses(blocks(2).select(np.flatnonzero(elimination.left)))
    assert without[2] == pytest.approx(left.variance(J))
    assert elimination.variance(J) == pytest.approx(left.variance(J))
