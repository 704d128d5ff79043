"""Scenarios: reproducible, spread over kinds and strengths, and honest about what a recording without a column can show."""

import numpy as np
import pytest

from mbcacq.challenge.scenarios import NONE, OUTSIDE, catalogued, draw, kinds
from mbcacq.errors import ConfigError


def test_the_same_seed_draws_the_same_envelopes_and_another_seed_others():
    first, again, other = (draw(seed, 40, kinds("mixed")) for seed in (5, 5, 6))
    assert first == again
    assert [e.seed for e in first] != [e.seed for e in other]
    assert [e.excess for e in first] != [e.excess for e in other]


def test_fewer_envelopes_are_the_beginning_of_more():
    assert draw(3, 10, kinds("catalogue")) == draw(3, 30, kinds("catalogue"))[:10]


def test_every_kind_occurs_equally_often_and_no_cell_twice():
    scenarios = draw(0, 3 * len(catalogued()), kinds("catalogue"))
    count = {k: sum(e.kind == k for e in scenarios) for k in catalogued()}
    assert set(count.values()) == {3}
    assert len({e.seed for e in scenarios}) == len(scenarios)


def test_strengths_span_barely_visible_to_plain():
    excess = np.array([e.excess for e in draw(1, 400, kinds("catalogue"))])
    assert excess.min() >= 0.05
    assert excess.max() <= 10.0
    assert np.quantile(excess, 0.1) < 0.15
    assert np.quantile(excess, 0.9) > 3.0


def test_clean_cells_conceal_nothing_and_two_conceal_two_different():
    none, two = draw(0, 1, [NONE])[0], draw(0, 1, ["two"])[0]
    assert none.names == ()
    assert len(set(two.names)) == 2


def test_without_times_no_drift_is_injected():
    left = kinds("catalogue", ["time_s", "temperature"])
    assert "station_drift" not in left
    assert "thermal_growth" not in left
    assert "joint_compliance" in left
    assert "backlash" not in kinds("catalogue", ["direction"])
    with pytest.raises(ConfigError, match="without direction none of the effects 'backlash' can be identified"):
        kinds("backlash", ["direction"])


def test_an_unknown_effect_is_refused_by_name():
    with pytest.raises(ConfigError, match="no effect 'rust' to inject"):
        kinds("backlash,rust")


def test_what_lies_outside_is_not_in_the_catalogue_of_the_diagnosis():
    from mbcacq.effects.catalogue import effects

    assert not set(OUTSIDE) & set(effects())
    assert set(catalogued()) <= set(effects())
