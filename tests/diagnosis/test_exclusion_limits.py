"""Limits of what could hide: they hold for the orders and moments that they name, with everything free that an effect is confused with."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.output.compensation import Compensation
from mbcacq.diagnosis.output.exclusion_limits import BandScan, confounders, limits_of, limits_of_bands, parameters_of, with_confounders
from mbcacq.diagnosis.output.next_measurements import as_measured
from mbcacq.diagnosis.output.sufficient_poses import of_fewest_coefficients
from mbcacq.diagnosis.output.upper_limit import ORDERS, LimitBand, bands, directions, largest_ratio, upper_limit
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.model.computed_once import ComputedOnce

SLOW, FAST = 1.0, 30.0


@pytest.fixture(scope="module")
def setup():
    return prepare(simulated.observe(simulated.plan(6, 2, 6), 61))


@pytest.fixture(scope="module")
def projected(setup):
    return CandidateScoring.of(setup.linear, setup.noise)


@pytest.fixture(scope="module")
def few(setup):
    return of_fewest_coefficients(setup.candidates)


def one(candidates, name, *where):
    return next(c for c in candidates if c.name == name and c.where == where)


def test_a_name_that_no_drive_of_the_arm_can_have_needs_no_limit(setup):
    assert "joint_scale" in {c.name for c in setup.candidates}
    assert {c.name for c in setup.candidates} - {c.name for c in setup.possible} == {"joint_scale"}


def drawn(projected, X, coefficients, rng):
    """The projected problem of a recording with that effect and unit noise."""
    r0 = X @ coefficients + rng.normal(size=len(X))
    return replace(projected, r0=r0, r=r0 - projected.Q @ (projected.Q.T @ r0), known=ComputedOnce(), known_beside=ComputedOnce())


def band_of(gear, order):
    """The band of a gear's errors in which an order is, or the first one above it."""
    return next(b for b in bands(gear) if max(b.values) >= order)


def test_orders_that_a_gear_has_by_its_construction_have_a_limit_of_their_own(few):
    gear = one(few, "gear_transmission_error", "A2")
    alone = [b.values[0] for b in bands(gear) if len(b.values) == 1]
    assert set(alone) == {1.0, 2.0, *gear.hyper.preferred}
    wide = [b.values for b in bands(gear) if len(b.values) > 1]
    assert [min(v) >= low and max(v) < high for v, low, high in zip(wide, ORDERS[:-1], ORDERS[1:], strict=True)] == [True] * 6
    assert not any(set(alone) & set(v) for v in wide)
    beside_an_order = bands(gear, found=[2.0])
    assert not any(1.5 <= v < 2.5 for b in beside_an_order for v in b.values)


def test_the_first_order_may_hide_where_a_fast_one_may_not(projected, few):
    gear = one(few, "gear_transmission_error", "A2")
    beside = with_confounders(projected, gear, few)
    slow, fast = (limits_of_bands(beside, gear, [band_of(gear, order)])[0].value for order in (SLOW, FAST))
    assert slow > 5 * fast


def test_a_limit_beside_what_it_is_confused_with_is_larger(projected, few):
    """Elasticity and a slow error of one joint compensate each other."""
    soft = one(few, "joint_compliance", "A2")
    (band,) = bands(soft)
    (alone,) = limits_of_bands(projected, soft, [band])
    (beside,) = limits_of_bands(with_confounders(projected, soft, few), soft, [band])
    assert beside.value > 1.5 * alone.value


@pytest.mark.parametrize("order", [SLOW, FAST])
def test_nineteen_of_twenty_errors_of_a_gear_are_below_the_limit_of_their_band(projected, few, order):
    """Errors of any phase and any order of the band, with an elasticity of usual size that is not known; neither fewer, nor nearly all."""
    gear, soft = one(few, "gear_transmission_error", "A2"), one(few, "joint_compliance", "A2")
    band, rng, below, trials = band_of(gear, order), np.random.default_rng(5), 0, 150
    blocks = {v: np.concatenate([projected.block(gear, v), projected.block(soft, None)], axis=1) for v in band.values}
    nothing = np.zeros(3)
    for _ in range(trials):
        value, angle = rng.choice(band.values), rng.uniform(0, 2 * np.pi)
        quiet = drawn(projected, blocks[value], nothing, rng)
        (limit,) = limits_of_bands(with_confounders(quiet, gear, few), gear, [band])
        true = np.radians(limit.value) * np.array([np.cos(angle), np.sin(angle)])
        one_day = drawn(projected, blocks[value], np.r_[true, soft.typical], rng)
        (again,) = limits_of_bands(with_confounders(one_day, gear, few), gear, [band])
        below += again.value >= limit.value
    assert 0.90 <= below / trials <= 0.995


def test_the_limit_of_a_coefficient_of_known_sign_is_that_of_a_normal_variable():
    """Estimate + 1.645 standard deviations, of an estimate below -1 standard deviation as if it were there."""
    for estimate, size in ((2.0, 3.645), (0.0, 1.645), (-1.0, 0.645), (-4.0, 0.645)):
        t = largest_ratio(np.array([[estimate * 0.1]]), np.array([[[0.01]]]), True)
        assert upper_limit(float(t), np.array([[100.0]]), 1.0, 1, True) == pytest.approx(size / 10, abs=2e-4)


def test_of_a_strong_effect_the_limit_is_its_estimate_and_a_little():
    for k in (1, 2, 3):
        c, V = np.zeros((1, k)), np.eye(k)[None]
        c[0, 0] = 100.0
        t = float(largest_ratio(c, V, False))
        assert upper_limit(t, np.ones((1, len(directions(k)))), 1.0, k, False) == pytest.approx(101.645, abs=0.02)


@pytest.mark.parametrize(("k", "values", "worst"), [(1, 40, 1.0), (2, 30, 1.0), (2, 1, 5.0), (3, 1, 3.0)])
def test_nineteen_of_twenty_effects_of_any_direction_at_any_of_many_values_are_below_their_limit(k, values, worst):
    """values independent ones, one of the directions determined worse than the others."""
    rng, std = np.random.default_rng(8), np.r_[worst, np.ones(k - 1)]
    V = np.broadcast_to(np.diag(std**2), (values, k, k))
    along = directions(k)
    precision = np.einsum("dk,hkl,dl->hd", along, np.linalg.inv(V), along)
    below, trials = 0, 600
    for _ in range(trials):
        quiet, there = rng.normal(size=(2, values, k)) * std
        size = upper_limit(float(largest_ratio(quiet, V, False)), precision, values, k, False)
        direction = rng.normal(size=k)
        there[rng.integers(values)] += size * direction / np.linalg.norm(direction)
        below += upper_limit(float(largest_ratio(there, V, False)), precision, values, k, False) >= size
    assert 0.93 <= below / trials <= 0.98


def test_moments_next_to_each_other_are_hardly_two_independent_values(projected, few):
    step = one(few, "joint_step", "A4")
    (band,) = bands(step)
    number = BandScan(projected, step, [band]).independent(band, "A4.step_deg", np.array([0]))
    assert 2 < number < 0.7 * len(band.values)


def test_what_hides_an_effect_acts_elsewhere_too(projected, few, setup):
    """At the poses of the recording a slow error of a gear is hidden, as large as its limit: what compensates it leaves little of it."""
    gear = one(few, "gear_transmission_error", "A2")
    (limit,) = limits_of_bands(with_confounders(projected, gear, few), gear, [band_of(gear, SLOW)])
    there = as_measured(setup.context)
    alone = there.displacement(limit.effect)
    hidden = Compensation.of(projected, there).displacement(limit.effect, confounders(gear, few))
    # A station absorbs what moves all of its poses alike.
    station = setup.linear.obs.station
    left, by_itself = (within(moved, station, there) for moved in (hidden, alone))
    assert left < 0.3 * by_itself
    assert left < 0.05


def within(moved, station, there):
    """rms (mm) of displacements (P, 3), in the base, about the mean of their station."""
    T = there.linear.prediction.T_base_scanner[:, :3, :3]
    in_base = np.einsum("pij,pj->pi", T, moved)
    means = np.array([in_base[station == s].mean(axis=0) for s in range(station.max() + 1)])
    return float(np.sqrt(np.mean(np.sum((in_base - means[station]) ** 2, axis=1))))


def test_what_an_effect_reports_are_lengths_of_its_own_coefficients(few):
    shift = parameters_of(one(few, "mount_shift", "mount"), 20.0)
    assert {name: list(which) for name, (which, _) in shift.items()} == {"translation_mm": [0, 1, 2], "rotation_deg": [3, 4, 5]}
    assert [list(which) for which, _ in parameters_of(one(few, "gear_transmission_error", "A4"), 2.0).values()] == [[0, 1]]


def test_limits_hold_at_moments_within_a_station_alone(projected, few, setup):
    """A mount that shifts just when the station changes moves every station as a whole."""
    (translation, _) = limits_of_bands(projected, one(few, "mount_shift", "mount"), bands(one(few, "mount_shift", "mount")))
    station = setup.linear.obs.station[np.argsort(setup.context.order)]
    changes = set((np.flatnonzero(np.diff(station)) + 1).tolist())
    inside = [v for v in translation.band.values if v not in changes]
    assert len(inside) > 0.5 * len(station)
    assert translation.value < 10.0


def test_nothing_is_limited_where_it_was_found(projected, few):
    gear, scale = one(few, "gear_transmission_error", "A4"), one(few, "joint_scale", "A5")
    limits = limits_of(projected, [gear, scale], [Member(gear, 2.0), Member(scale, None)])
    assert {limit.effect.candidate.name for limit in limits} == {"gear_transmission_error"}
    assert not any(min(e.band.values) <= 2.0 <= max(e.band.values) for e in limits)


def scan_of(information: np.ndarray, values: tuple[float, ...], drawn: np.ndarray) -> BandScan:
    """A scan over values (H,) at which a coefficient has this information (H,), with right-hand sides (H, N) of recordings of noise."""
    S = information[:, None, None]
    problem = SimpleNamespace(
        normal_matrices=lambda candidate, at: (S, np.zeros((len(at), 1))),
        scores_of_noise=lambda candidate, at: (S, drawn[:, None, :]),
        known=ComputedOnce(),
    )
    candidate = SimpleNamespace(typical=np.ones(1), components=(1,), key="a", positive=False, k=1)
    return BandScan(problem, candidate, [LimitBand(values)])


def test_a_value_that_the_geometry_absorbs_does_not_disturb_the_limits_at_others():
    """Of a short recording, a gear's error of one order may be absorbed and that of the next not."""
    drawn = np.random.default_rng(1).normal(size=(6, 400))
    drawn[2] = 0.0
    band = LimitBand((1.0, 2.0, 4.0, 5.0, 6.0))
    some = np.array([0, 1, 3, 4, 5])
    whole = scan_of(np.array([1.0, 1, 0, 1, 1, 1]), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), drawn)
    number = whole.independent(band, "size", np.array([0]))
    assert number == scan_of(np.ones(5), band.values, drawn[some]).independent(band, "size", np.array([0]))
    assert 4.0 < number < 6.5  # five values whose noise has nothing in common
