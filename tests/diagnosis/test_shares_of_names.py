"""A name explains a part of a mismatch where it surely removes a substantial share of it, whatever of its figures is open."""

import pytest

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.verdict import names_explain
from mbcacq.effects.effect import ParameterEstimate

SIZE = {"A1.rms_deg": ParameterEstimate(0.02, 0.004)}  # of lines whose orders are not determined


@pytest.mark.parametrize(
    ("name", "size", "gain", "std", "explains"),
    [
        ("gear_transmission_error", SIZE, 0.76, 0.003, True),
        ("gear_transmission_error", SIZE, 0.14, 0.03, False),  # within U of a tenth
        ("gear_transmission_error", {"A1.rms_deg": ParameterEstimate(0.02, 0.02)}, 0.76, 0.003, False),  # a trend
        ("unknown", SIZE, 0.76, 0.003, False),
    ],
)
def test_a_part_is_explained_by_a_sure_and_substantial_share(name, size, gain, std, explains):
    effect = EffectFound(name=name, where=("A1",), parameters=size, p_value=1e-9, held_out_gain=gain, held_out_gain_std=std)
    assert names_explain([effect]) is explains


def test_nothing_found_explains_nothing():
    assert not names_explain([])
