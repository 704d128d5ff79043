"""Stated standard deviations against the scatter of many recordings, and against the prior."""

import numpy as np
import pytest
from scipy.signal import lfilter

from mbcacq.diagnosis.motion.noise import covariance
from mbcacq.diagnosis.motion.normal_store import NormalStore
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals

STEP, LENGTH = 0.004, 3000
TIME = STEP * np.arange(LENGTH)
COLUMN = np.sin(2.1 * TIME + 0.3 * np.sin(0.7 * TIME))[:, None]


def run():
    still = np.zeros((LENGTH, 1))
    return MotionSignals(STEP, still, still, still, still, still)


def normal_store(noise):
    group = ChannelGroup(
        name="q_joint",
        unit="rad",
        joints=(0,),
        mismatch=(noise[:, None],),
        use=(np.ones((LENGTH, 1), dtype=bool),),
        base=(np.zeros((LENGTH, 1, 0)),),
        prior=np.zeros(0),
        refit=True,
    )
    return NormalStore(group, (run(),))


def fitted(noise, prior=None):
    """Coefficient of COLUMN in pure noise and its stated standard deviation."""
    store = normal_store(noise)
    number = store.add([0], [COLUMN], prior)
    chosen = np.concatenate([store.base, number])
    weights = np.array([1.0 / np.mean(noise**2)])
    x = store.solve(store.normal(weights), chosen)
    return x[-1], float(np.sqrt(covariance(store, weights, chosen, x, NUMBERS.correlation_s)[-1, -1]))


@pytest.mark.parametrize("correlation_s", [0.0, 0.02, 0.1])
def test_stated_deviation_is_the_scatter_also_in_coloured_noise(correlation_s):
    rng = np.random.default_rng(5)
    keep = np.exp(-STEP / correlation_s) if correlation_s else 0.0
    fits = np.array([fitted(lfilter([1.0], [1.0, -keep], rng.normal(size=LENGTH + 500))[500:]) for _ in range(150)])
    scatter, stated = fits[:, 0].std(), np.median(fits[:, 1])
    assert stated == pytest.approx(scatter, rel=0.2)


def test_a_coefficient_that_the_data_do_not_determine_keeps_its_prior():
    value, std = fitted(1e6 * np.random.default_rng(6).normal(size=LENGTH), np.array([0.3]))
    assert std == pytest.approx(0.3, rel=0.02)
    assert abs(value) < 0.1


def stated(store, weights, chosen):
    return covariance(store, weights, chosen, store.solve(store.normal(weights), chosen), NUMBERS.correlation_s)


@pytest.mark.filterwarnings("error")
def test_a_coefficient_of_a_column_that_is_zero_has_a_variance_beyond_any_size_and_no_other_one_changes():
    noise = np.random.default_rng(7).normal(size=LENGTH)
    store = normal_store(noise)
    (number,), (empty,) = store.add([0], [COLUMN], None), store.add([0], [np.zeros_like(COLUMN)], None)
    weights = np.array([1.0 / np.mean(noise**2)])
    alone, both = (np.concatenate([store.base, chosen]).astype(int) for chosen in ([number], [number, empty]))
    one, other = (stated(store, weights, chosen) for chosen in (alone, both))
    assert other[-2, -2] == pytest.approx(one[-1, -1], rel=1e-6)
    assert 1e100 < other[-1, -1] < np.inf


@pytest.mark.parametrize("seed", range(5))
def test_nearly_dependent_columns_that_leave_nothing_have_a_covariance(seed):
    """Sines on a slope ten thousand times as large: their residual is rounding, which makes no variance negative and no correlation beyond one."""
    rng = np.random.default_rng(seed)
    columns = np.sin(np.outer(TIME, rng.uniform(0.2, 3.0, 8)))
    columns[:, 1:] += 1e4 * columns[:, :1]
    mismatch = columns @ rng.normal(size=8)
    store = normal_store(mismatch)
    chosen = np.concatenate([store.base, *(store.add([0], [column[:, None]], None) for column in columns.T)]).astype(int)
    weights = np.array([1.0 / np.mean(mismatch**2)])
    C = stated(store, weights, chosen)
    assert np.diag(C).min() > 0
    std = np.sqrt(np.diag(C))
    assert np.linalg.eigvalsh(C / np.outer(std, std)).min() > -1e-9
