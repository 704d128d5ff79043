"""What a recording shows, its halves show again, or it is said that they do not; an order is stated with all that it may be."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.effect_found import NOT_FOUND_AGAIN, SELDOM_FOUND, EffectFound, FoundAgain
from mbcacq.diagnosis.evidence.order_posterior import OrderPeak
from mbcacq.diagnosis.model_fit import PartModel
from mbcacq.diagnosis.nonparametric.joint_model import RandomEffect
from mbcacq.diagnosis.output.orders import fast_part, pooled_spread, rms_over_angles, stated_orders
from mbcacq.diagnosis.output.repetition import sentences
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet, Member
from mbcacq.diagnosis.validation.folds import blocks
from mbcacq.diagnosis.validation.found_again import (
    jackknife,
    relative_sizes,
    relative_spread,
    shows,
    spread_of_kinds,
    with_spread_between_parts,
)
from mbcacq.diagnosis.verdict import not_found_again
from mbcacq.effects.effect import ParameterEstimate

RESOLUTION = 0.7  # of a joint that was seen over 514 degrees


def gear(orders, sigmas, amplitudes=None, halves=None, found_in=2):
    """Lines of A6, and what two halves have in their place."""
    k = len(orders)
    amplitudes = np.full(k, 0.02) if amplitudes is None else np.array(amplitudes)

    def stated(orders, sigmas, amplitudes):
        each = {
            "order": (orders, sigmas),
            "amplitude_deg": (amplitudes, [5e-4] * len(orders)),
            "phase_deg": ([30.0] * len(orders), [2.0] * len(orders)),
        }
        return {f"A6.{name}": ParameterEstimate(tuple(v), tuple(s)) for name, (v, s) in each.items()}

    again = ()
    if halves is not None:
        parts = [stated(one, [0.01] * len(one), np.full(len(one), 0.02)) for one in halves]
        again = (FoundAgain("A6", found_in, 2, True, {name: tuple(p[name] for p in parts) for name in parts[0]}),)
    return EffectFound(
        name="gear_transmission_error",
        where=("A6",),
        parameters=stated(orders, sigmas, amplitudes),
        p_value=1e-9,
        held_out_gain=0.9,
        found_again=again,
    )


def with_orders(effect, others=None):
    (parts,) = effect.found_again or (None,)
    return stated_orders(effect, "A6", others or [()] * 9, parts, RESOLUTION)


def test_an_order_that_both_halves_have_is_stated_no_surer_than_they_agree():
    found = with_orders(gear([22.0], [0.003], halves=[[21.98], [22.04]]))
    assert found.parameters["A6.order"].value == 22.0
    assert found.parameters["A6.order"].std == pytest.approx(0.03)
    assert [(one.order, one.odds, one.determined) for one in found.orders] == [(22.0, 1.0, True)]


def test_an_alias_that_one_half_has_is_an_order_that_it_may_be():
    found = with_orders(gear([10.99], [0.005], halves=[[10.98], [11.98]]))
    assert [(one.order, one.odds) for one in found.orders] == [(10.99, 1.0), (11.98, 1.0)]
    assert not any(name.endswith(("order", "phase_deg")) for name in found.parameters)
    assert found.parameters["A6.rms_deg"].value == pytest.approx(0.02 / np.sqrt(2))
    (line,) = [line for line in sentences(found) if "of order" in line]
    assert line == "A6: a line of order 10.990 ± 0.010 or 11.980 ± 0.020 (odds 1 : 1)"


def test_a_line_that_one_half_lacks_is_not_determined_and_the_other_lines_are():
    found = with_orders(gear([11.0, 22.0], [0.01, 0.01], halves=[[11.0, 22.0], [22.0]]))
    assert found.parameters["A6.order"].value == 22.0
    assert {(one.order, one.determined) for one in found.orders} == {(11.0, False), (22.0, True)}
    assert "A6: the order of 1 of 2 lines is not determined (about 11)" in " ".join(sentences(found))


@pytest.mark.parametrize(("sigma", "determined"), [(0.24, True), (0.26, False), (0.6, False)])
def test_an_order_that_does_not_tell_whole_numbers_apart_is_not_stated(sigma, determined):
    found = with_orders(gear([1.0], [sigma]))
    assert ("A6.order" in found.parameters) is determined
    assert ("A6.rms_deg" in found.parameters) is not determined


def test_lines_closer_than_two_periods_over_the_travel_are_not_determined_where_halves_were_asked():
    near, far = (with_orders(gear(one, [0.01, 0.01], halves=[one, one])) for one in ([11.0, 12.2], [11.0, 12.6]))
    assert not any(one.determined for one in near.orders)
    assert all(one.determined for one in far.orders)


def test_less_than_a_period_over_the_travel_has_no_order_where_halves_were_asked():
    slow, whole = (with_orders(gear([order], [0.01], halves=[[order], [order]])) for order in (0.6, 0.8))
    assert not any(one.determined for one in slow.orders)
    assert all(one.determined for one in whole.orders)


def test_beside_a_single_line_stands_the_rms_of_all_that_a_long_recording_shows_of_the_joint():
    effect = gear([22.0], [0.003], halves=[[22.0], [22.0]])
    (parts,) = effect.found_again
    found = stated_orders(effect, "A6", [()], parts, RESOLUTION, whole=ParameterEstimate(0.03, 0.004))
    assert found.parameters["A6.order"].value == 22.0
    assert found.parameters["A6.rms_deg"].value == 0.03
    assert found.parameters["A6.rms_deg"].std == pytest.approx(np.hypot(0.004, 0.03 * 5e-4 / 0.02))


def test_the_rms_of_an_error_is_as_uncertain_as_the_angles_at_which_it_was_seen_differ():
    angle = np.random.default_rng(5).permutation(np.linspace(0, 2, 4000))
    even = rms_over_angles(angle, np.sin(40 * np.pi * angle))
    grown = rms_over_angles(angle, np.where(angle < 1, 1.0, 2.0) * np.sin(40 * np.pi * angle))
    assert even == ParameterEstimate(pytest.approx(np.sqrt(0.5), rel=1e-3), pytest.approx(0.0, abs=1e-3))
    assert abs(grown.value - 2 * even.value) < 2 * np.hypot(grown.std, even.std) * 1.1  # what its second half alone would show


def test_an_order_is_no_surer_than_those_of_all_joints_differ_between_halves():
    gears = [gear([22.0], [0.003], halves=[[21.99], [22.01]]), gear([11.0], [0.003], halves=[[10.9], [11.1]])]
    spread = pooled_spread(gears, {"A6": RESOLUTION})
    assert spread.order == pytest.approx(np.sqrt((0.1**2 + 0.01**2) / 2) / RESOLUTION)
    (parts,) = gears[0].found_again
    found = stated_orders(gears[0], "A6", [()], parts, RESOLUTION, spread, 0.5)
    assert found.parameters["A6.order"].std == pytest.approx(spread.order * RESOLUTION)
    assert found.parameters["A6.phase_deg"].std == pytest.approx(np.hypot(2.0, np.degrees(0.5 * spread.order * RESOLUTION)), rel=1e-3)


def test_more_than_three_peaks_leave_an_order_undetermined():
    peaks = tuple(OrderPeak(7.0 + 24 * k, 0.01, 0.9) for k in range(1, 4))
    two, four = (with_orders(gear([7.0], [0.01]), [peaks[:n]]) for n in (1, 3))
    assert all(one.determined for one in two.orders)
    assert not any(one.determined for one in four.orders)
    assert len(four.orders) == 4


def test_what_halves_do_not_both_show_is_a_trend_and_explains_nothing():
    once, twice = (replace(gear([3.0], [0.01]), found_again=(FoundAgain("A6", n, 2, True),)) for n in (1, 2))
    assert once.trend == NOT_FOUND_AGAIN
    assert twice.trend == ""
    assert not_found_again([twice]) == []
    (note,) = not_found_again([once, twice])
    assert note.startswith("parts of the recording do not show gear_transmission_error at A6 again")
    assert "found again in 1 of 2 halves by blocks" in sentences(once)
    seldom, few = (replace(once, found_again=(FoundAgain("A6", n, 4, False),)) for n in (1, 3))
    assert seldom.trend == replace(seldom, held_out_gain=0.0).trend == SELDOM_FOUND  # where it was not found, nothing says what it removes
    assert (seldom.removes, few.removes) == (False, True)
    assert few.trend == ""
    assert "found again in 3 of 4 searches without a part of the poses (too few poses for halves)" in sentences(few)


def test_a_size_is_no_surer_than_halves_agree():
    soft = EffectFound(
        name="joint_compliance",
        where=("A2",),
        parameters={"A2.compliance_rad_per_Nm": ParameterEstimate(9e-6, 1e-7)},
        p_value=1e-9,
        held_out_gain=0.9,
        found_again=(
            FoundAgain("A2", 2, 2, True, {"A2.compliance_rad_per_Nm": tuple(ParameterEstimate(v, 2e-7) for v in (9.9e-6, 7.3e-6))}),
        ),
    )
    (found,) = with_spread_between_parts([soft])
    assert found.parameters["A2.compliance_rad_per_Nm"] == ParameterEstimate(9e-6, pytest.approx(1.3e-6))
    overlapping = replace(soft, found_again=tuple(replace(one, disjoint=False) for one in soft.found_again))
    assert with_spread_between_parts([overlapping]) == [overlapping]


def test_a_figure_whose_halves_agree_by_chance_is_no_surer_than_the_others_of_its_effect():
    halves = {"about_x_rad": (1e-5, 5e-5), "about_y_rad": (3e-5, 3e-5)}
    bias = EffectFound(
        name="orientation_bias",
        where=("target",),
        parameters={name: ParameterEstimate(3e-5, 1e-6) for name in halves},
        p_value=1e-9,
        held_out_gain=0.9,
        found_again=(FoundAgain("target", 2, 2, True, {k: tuple(ParameterEstimate(v, 1e-6) for v in each) for k, each in halves.items()}),),
    )
    (found,) = with_spread_between_parts([bias])
    assert found.parameters["about_x_rad"].std == pytest.approx(2e-5)
    assert found.parameters["about_y_rad"].std == pytest.approx(2e-5 / np.sqrt(2))


def model(*sizes):
    """A part of a recording with an unmodelled effect of each joint's angle."""
    groups = [RandomEffect(f"A{j + 1}", f"q{j + 1}", (), size * np.array([1.0, 0.5])) for j, size in enumerate(sizes)]
    return PartModel(model=NO_EFFECTS, random=tuple(groups), stated={})


def test_something_unmodelled_that_one_half_lacks_is_as_uncertain_as_it_is_large():
    sizes = relative_sizes(model(2.0, 3.0).random, [model(2.0, 3.0), model(2.0)], ("A2", "q2"))
    assert sizes.tolist() == [1.0, 0.0]
    assert relative_spread(sizes) == 1.0
    assert relative_spread(np.array([1.0, 1.0])) == 0.0


def test_what_halves_put_now_to_one_link_and_now_to_the_next_is_at_none_for_certain():
    same, once = np.array([1.0, 1.0]), np.array([1.0, 0.0])
    spread = spread_of_kinds({("link1", "q1"): same, ("link2", "q2"): once, ("A1", "q1"): same, ("A2", "q2"): same})
    assert spread["A1", "q1"] == 0.0
    assert spread["link1", "q1"] == spread["link2", "q2"] == pytest.approx(np.sqrt(0.5))


def test_the_size_of_one_kind_is_no_surer_than_halves_agree_on_it_and_another_kind_stays_as_sure_as_it_is():
    whole = [RandomEffect(at, on, (), np.array([1.0])) for at, on in (("A1", "q1"), ("A2", "q2"), ("mount", "q6"))]
    halves = [[replace(g, sigma=size * g.sigma) for g, size in zip(whole, sizes, strict=True)] for sizes in ([1.1, 0.9, 2], [0.9, 1.1, 1])]
    parts = [PartModel(model=NO_EFFECTS, random=tuple(half), stated={}) for half in halves]
    keys = [(g.location, g.depends_on) for g in whole]
    spread = spread_of_kinds({key: relative_sizes(whole, parts, key) for key in keys})
    assert [spread[key] for key in keys] == pytest.approx([0.1, 0.1, 1 / 3])


def test_something_unmodelled_that_a_part_has_under_another_name_is_found_again():
    named = EffectSet((Member(simulated.candidate("lost_motion", "A3", [1.0]), None),))
    part = PartModel(model=named, random=(), stated={})
    assert shows(part, "A3", {"backlash:A3"})
    assert not shows(part, "A3", {"lost_motion:A3"})
    assert not shows(part, "A2", set())


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(2).normal(size=12)
    without = [np.delete(values, k).mean() for k in range(12)]
    assert jackknife(np.array(without)[:, None])[0] == pytest.approx(values.std(ddof=1) / np.sqrt(12))


def test_halves_are_blocks_that_share_no_pose():
    obs = simulated.plan(6, 2, 6)
    half = blocks(obs, 2)
    order = np.argsort(obs.time_s)
    assert np.array_equal(np.unique(half), [0, 1])
    assert abs(np.sum(half == 0) - np.sum(half == 1)) <= 8
    assert np.sum(np.diff(half[order]) != 0) == 7


def test_what_geometry_and_gravity_could_do_is_no_part_of_the_error_of_a_gear():
    angle = np.random.default_rng(3).uniform(-1.5, 1.5, 800)
    slow, fast = 5.0 * np.cos(angle) - 2.0 * angle + 1.0, np.sin(14.0 * angle)

    np.testing.assert_allclose(fast_part(angle, slow + fast).std(), np.sqrt(0.5), rtol=0.06)
    assert fast_part(angle, slow).std() < 0.05
