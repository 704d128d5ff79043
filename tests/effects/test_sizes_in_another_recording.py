"""What differs between recordings is, in another one, as large as it was found."""

from dataclasses import replace

import numpy as np
import pytest

from mbcacq.effects.effect_term import UNKNOWN, EffectTerm
from mbcacq.effects.functions import DescribedPart, linear

SHIFT = EffectTerm(
    name="mount_shift",
    where=("mount",),
    depends_on="pose",
    parts=(DescribedPart("frame", 6, 0, (linear("pose"),)),),
    names=("x", "y"),
    units=("mm", "mm"),
    coefficients=np.array([0.03, 0.04]),
    std=np.zeros(2),
    sigma=np.array([0.9, 0.9]),
    typical=np.array([0.03, 0.03]),
)


def test_a_shift_found_with_a_hundredth_of_its_prior_is_no_larger_elsewhere():
    assert SHIFT.sigma_elsewhere == pytest.approx(np.full(2, np.sqrt(np.mean([0.03**2, 0.04**2]))))


def test_an_uncertain_size_counts_with_its_uncertainty_and_never_beyond_the_prior():
    assert replace(SHIFT, std=np.array([0.05, 0.0])).sigma_elsewhere[0] > SHIFT.sigma_elsewhere[0]
    assert replace(SHIFT, std=np.array([9.0, 9.0])).sigma_elsewhere == pytest.approx(SHIFT.sigma)


def test_an_unmodelled_effect_has_the_size_that_was_estimated():
    assert replace(SHIFT, name=UNKNOWN).sigma_elsewhere == pytest.approx(SHIFT.sigma)
