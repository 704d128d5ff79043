"""Products of columns that are never written out are those of the columns."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.problem import prepare
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.unmodelled import everywhere, group
from mbcacq.estimation.pose_block import PoseBlock
from mbcacq.estimation.terms import Part
from mbcacq.estimation.whitened_columns import WhitenedColumns, is_wide


@pytest.fixture(scope="module")
def linear():
    observed = simulated.observe(simulated.plan(stations=6, bars=4, each=12), 171, [("joint_compliance", ("A2",), [2e-6], None)])
    whole = prepare(observed).linear
    return whole.restricted(np.random.default_rng(5).uniform(size=len(whole.keep)) > 0.1)


@pytest.fixture(scope="module")
def groups(linear):
    """Those of a recording, a wide one of a joint among them, and one of single centres."""
    found = [tuple(evaluated(Covariates(linear.obs), g.parts)) for g in everywhere(Covariates(linear.obs))]
    q, rng = linear.obs.q[:, 2], np.random.default_rng(6)
    orders = np.arange(1, 31)
    wide = (Part("joint", 2, 0, np.concatenate([np.sin(np.outer(q, orders)), np.cos(np.outer(q, orders))], axis=1)),)
    other = (Part("frame", 4, 1, rng.normal(size=(len(q), 40))),)
    single = (Part("point", 0, 2, rng.normal(size=(linear.obs.n_centres, 3))),)
    out = [wide, found[0], other, single, *found[1:]]
    assert sum(is_wide(parts) for parts in out) >= 2
    return out


def test_products_of_some_poses_are_those_of_the_columns_written_out(linear, groups):
    whiten = linear.whitener(prepare(linear.obs).noise)
    columns = WhitenedColumns(linear, whiten, linear.nuisance()[0], groups)
    poses = np.random.default_rng(7).uniform(size=linear.obs.n_poses) > 0.4
    change = np.random.default_rng(8).normal(size=(*linear.residual.shape, 2))

    for chosen, own in ((None, False), (poses, False), (poses, True)):
        every = np.concatenate([linear.nuisance()[0], *(linear.columns(parts) for parts in groups)], axis=2)
        here = columns
        if own:
            every[:, :, 3:5] += change
            here = columns.with_change(slice(3, 5), whiten(change))
        only = whiten if chosen is None else linear.restricted(linear.keep & chosen[linear.obs.pose]).whitener(whiten.noise)
        X, r = only(every), only(linear.residual)

        found = here.products(chosen)

        size = np.sqrt(np.diag(X.T @ X)) + 1e-12
        np.testing.assert_allclose(found.information / np.outer(size, size), X.T @ X / np.outer(size, size), atol=1e-10)
        np.testing.assert_allclose(found.right / size, X.T @ r / size, rtol=1e-8, atol=1e-8 * np.linalg.norm(r))
        assert found.square == pytest.approx(r @ r)


def test_displacements_and_products_with_rows_without_the_columns(linear, groups):
    rng = np.random.default_rng(9)
    for parts in groups:
        columns, values = linear.columns(parts), rng.normal(size=parts[0].basis.shape[1])
        rows = rng.normal(size=linear.residual.shape)
        np.testing.assert_allclose(linear.displacement(parts, values), columns @ values, rtol=1e-9, atol=1e-9 * np.abs(columns).max())
        expected = np.einsum("mrk,mr->k", columns, rows)
        np.testing.assert_allclose(linear.products(parts, rows), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_link_with_nothing_of_a_mass_behind_it_has_no_group_by_gravity(linear):
    robot = linear.obs.cell.robot
    massless = replace(robot, mass=np.where(np.arange(robot.n) < 4, robot.mass, 0.0), payload_mass=0.0)
    here = Covariates(replace(linear.obs, cell=replace(linear.obs.cell, robot=massless)))
    assert np.abs(here.gravity_moment(5)).max() == 0
    assert group(here, "link5", "gravity_torque_5") is None
    assert group(here, "link2", "gravity_torque_2") is not None


@pytest.mark.parametrize("joint_sigma", [1e-6, 1.0, 1e6, 1e9])
def test_a_poses_whitened_columns_have_the_information_of_its_rows_however_large_the_joint_noise(joint_sigma):
    """With one joint the information is L - L t t'L s^2 / (1 + s^2 t'L t) (Sherman and Morrison)."""
    rng = np.random.default_rng(3)
    P, R, B, u = 4, 3, 5, 6
    G, t = rng.normal(size=(P, R, B, u)), rng.normal(size=(P, u, 1))
    squares = (np.swapaxes(G, 2, 3) @ G).reshape(P, R, u * u)
    weighted = SimpleNamespace(place=None, share=np.ones(P), own=None, scale=np.ones((P, R, B)), G=G, squares=squares)
    weighted.by_axis = lambda residual: residual.reshape(P, B, R).transpose(0, 2, 1)
    columns = SimpleNamespace(joints=t, residual=np.zeros((P, B * R)))
    noise = SimpleNamespace(row_sigma=lambda width: np.ones(width))
    W = PoseBlock(weighted, columns, noise, np.full((P, 1, 1), joint_sigma)).whitened_basis
    L = squares.sum(axis=1).reshape(P, u, u)
    s2, tLt = joint_sigma**2, np.swapaxes(t, 1, 2) @ L @ t
    exact = L - L @ t @ np.swapaxes(t, 1, 2) @ L * (s2 / (1 + s2 * tLt))
    np.testing.assert_allclose(np.swapaxes(W, 1, 2) @ W, exact, atol=1e-6 * np.abs(L).max())
