"""Rules between what was found and what is reported: small effects, a block that may be an effect, columns that vanish."""

import pytest

from mbcacq.diagnosis.result import EffectFound
from mbcacq.diagnosis.verdict import reportable


def removing(share):
    return EffectFound("backlash", ("A2",), {}, 1e-4, share, depends_on="direction_2")


@pytest.mark.parametrize(("verdict", "least"), [("unexplained", 0.05), ("partly_explained", 0.005)])
def test_an_effect_that_explains_next_to_nothing_is_not_reported(verdict, least):
    effects = [removing(share) for share in (0.9 * least, 1.1 * least, 0.5)]

    assert reportable(effects, verdict) == effects[1:]


def test_where_effects_explain_all_a_small_one_is_reported_too():
    effects = [removing(0.001), removing(0.9)]

    assert reportable(effects, "explained") == effects
