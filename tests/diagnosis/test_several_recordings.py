"""Several recordings of one arm as one problem."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.calibration.several import calibrate_together
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.output.between_recordings import with_common_values
from mbcacq.diagnosis.problem import prepare
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.several_recordings import BetweenRecordings

OPTIONS = CalibrationOptions(refuse=False)


@pytest.fixture(scope="module")
def two_days(plan):
    """One arm on two days: another tool, other stations, other noise of the joints."""
    return [simulated.observe(plan, 300 + day, arm=7, joint_noise=noise) for day, noise in enumerate((5e-6, 2e-5))]


def test_two_days_have_one_arm_and_their_own_tool_and_noise(two_days):
    one, other = calibrate_together(two_days, OPTIONS)

    np.testing.assert_array_equal(one.state.chain.rows, other.state.chain.rows)
    assert np.linalg.norm(one.state.T_flange_scanner[:3, 3] - other.state.T_flange_scanner[:3, 3]) > 0.1
    assert 3.0 < np.mean(other.noise.joint / one.noise.joint) < 5.0
    assert one.fit.chi2 / one.fit.dof == pytest.approx(1.0, abs=0.1)
    assert other.fit.chi2 / other.fit.dof == pytest.approx(1.0, abs=0.1)


def test_two_days_determine_the_arm_better_than_either(two_days):
    together = calibrate_together(two_days, OPTIONS)[0]
    alone = [calibrate_together([one], OPTIONS)[0] for one in two_days]

    def std(calibration):
        return {p.name: p.std for p in calibration.parameters if p.std and p.name.startswith(("a_", "d_", "theta_", "alpha_"))}

    best = {name: min(std(a)[name] for a in alone) for name in std(alone[0])}
    assert all(value < 1.001 * best[name] for name, value in std(together).items())


def test_the_order_of_the_recordings_does_not_matter(two_days):
    there, back = calibrate_together(two_days, OPTIONS), calibrate_together(two_days[::-1], OPTIONS)

    for a, b in zip(there[0].parameters, back[1].parameters, strict=True):
        assert a.name == b.name
        assert a.std is None or abs(a.value - b.value) < 0.3 * a.std


def test_recordings_of_different_arms_are_refused(plan):
    robot = plan.cell.robot
    longer = replace(robot, chain=replace(robot.chain, a=robot.chain.a + 10.0))
    other = replace(plan, cell=replace(plan.cell, robot=longer))

    with pytest.raises(ConfigError, match="other links"):
        prepare([simulated.observe(plan, 1), simulated.observe(other, 2)])


def test_what_differs_from_day_to_day_is_no_more_certain_than_that():
    days = [simulated.observe(simulated.plan(4, 2, 6), 400 + day, [("joint_compliance", ("A2",), [4e-6], None)], arm=7) for day in range(2)]
    key = "A2.compliance_rad_per_Nm"

    found = diagnose(days, folds=2)

    (alike,) = (b for b in found.between_recordings if b.parameter == key)
    assert not alike.differs
    (effect,) = with_common_values(found.effects, [alike])
    assert effect == found.effects[0]
    assert abs(effect.parameters[key].value - 4e-6) < 4 * effect.parameters[key].std

    unlike = BetweenRecordings.of(effect.name, effect.where, key, np.array([4e-6, 7e-6]), np.array([2e-8, 2e-8]))
    (stated,) = (e.parameters[key] for e in with_common_values([effect], [unlike]))
    assert unlike.differs
    assert stated.value == pytest.approx(5.5e-6)
    assert all(abs(stated.value - value) < 2 * stated.std for value in (4e-6, 7e-6))


def test_the_variance_between_recordings_is_that_of_the_values():
    rng = np.random.default_rng(4)
    inside, found = 0, []
    for _ in range(400):
        std = rng.uniform(0.5, 1.5, 8)
        values = 10.0 + rng.normal(0, 2.0, 8) + std * rng.normal(size=8)
        b = BetweenRecordings.of("x", ("A1",), "p", values, std)
        found.append(b.between_std)
        inside += abs(b.common - 10.0) < 2.0 * b.common_std

    assert np.median(found) == pytest.approx(2.0, rel=0.15)
    assert 0.90 < inside / 400 < 0.97


def test_equal_values_have_no_variance_between_recordings():
    b = BetweenRecordings.of("x", ("A1",), "p", np.array([1.0, 1.01, 0.99]), np.array([0.1, 0.1, 0.1]))

    assert b.between_std == 0.0
    assert b.p_value > 0.9
