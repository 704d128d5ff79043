"""What is stated of an effect over all sets that are not excluded: the moments of the mixture, and sets that change a value."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from mbcacq.diagnosis.evidence.between_sets import alternatives_to, averaged, by_effect, is_changed
from mbcacq.diagnosis.evidence.hypothesis import SetPrior
from mbcacq.diagnosis.search.bayes_factor import log_set_bayes_factor, over_sizes
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects.effect import ParameterEstimate, PriorOdds, plain_effect
from mbcacq.effects.functions import DescribedPart, linear

KEY, LABEL = "A2.compliance_rad_per_Nm", "joint_compliance:A2"


def stated(value, std):
    return {LABEL: {KEY: ParameterEstimate(value, std)}}


def test_the_average_over_sets_has_the_moments_of_their_mixture():
    each = [(0.05, 0.2, 0.02), (0.9, 0.55, 0.1), (0.4, 0.5, 0.15)]
    sets = [(p, stated(value, std)) for p, value, std in each]
    (found,) = averaged(LABEL, sets[0][1][LABEL], sets[0][1], sets).values()
    rng = np.random.default_rng(0)
    share = np.array([p for p, *_ in each]) / sum(p for p, *_ in each)
    drawn = rng.choice(3, 400_000, p=share)
    draws = rng.normal([each[i][1] for i in drawn], [each[i][2] for i in drawn])
    assert found.value == pytest.approx(draws.mean(), abs=1e-3)
    assert found.std == pytest.approx(draws.std(), rel=0.01)


def test_sets_without_the_effect_say_nothing_of_it():
    sets = [(1.0, stated(0.2, 0.02)), (1.0, {"base_compliance:base": {"compliance": ParameterEstimate(9.0, 1.0)}})]
    assert averaged(LABEL, sets[0][1][LABEL], sets[0][1], sets)[KEY] == ParameterEstimate(0.2, 0.02)


def test_an_angle_is_averaged_the_shorter_way_round():
    own, other = ({LABEL: {"A1.phase_deg": ParameterEstimate(v, 1.0)}} for v in (179.0, -179.0))
    (found,) = averaged(LABEL, own[LABEL], own, [(1.0, own), (1.0, other)]).values()
    assert found.value == pytest.approx(180.0)
    assert found.std < 2.0


def test_orders_of_a_gear_are_averaged_each_with_itself_however_a_set_lists_them():
    label = "gear_transmission_error:A1"
    orders, turned = (100.0, 2.0), (2.0, 100.0)
    own, other = (
        {label: {"A1.order": ParameterEstimate(order, (0.1, 0.1)), "A1.amplitude_deg": ParameterEstimate(size, (1e-4, 1e-4))}}
        for order, size in ((orders, (0.004, 0.003)), (turned, (0.003, 0.004)))
    )
    found = averaged(label, own[label], own, [(1.0, own), (0.5, other)])
    assert found["A1.order"].value == pytest.approx(orders)
    assert found["A1.order"].std == pytest.approx((0.1, 0.1))
    assert found["A1.amplitude_deg"].value == pytest.approx((0.004, 0.003))
    assert not is_changed(own[label], other[label])


def gear(*orders):
    """What a set states of a gear that has these orders, each with an amplitude of a thousandth of its order."""
    std = (0.05,) * len(orders)
    size = ParameterEstimate(tuple(1e-3 * n for n in orders), (1e-4,) * len(orders))
    return {"gear_transmission_error:A1": {"A1.order": ParameterEstimate(orders, std), "A1.amplitude_deg": size}}


@pytest.mark.parametrize("other", [(100.1, 30.0), (30.0, 100.1), (30.0, 100.1, 60.0), (100.1,)])
def test_an_order_is_averaged_over_the_sets_that_have_it_and_another_order_is_another_effect(other):
    label = "gear_transmission_error:A1"
    own, sets = gear(2.0, 100.0), gear(*other)
    found = averaged(label, own[label], own, [(1.0, own), (1.0, sets)])
    assert found["A1.order"].value == pytest.approx((2.0, 100.05))
    assert found["A1.amplitude_deg"].value == pytest.approx((0.002, 0.10005))
    assert found["A1.amplitude_deg"].std == pytest.approx((1e-4, np.hypot(1e-4, 0.5e-4)))
    assert is_changed(own[label], sets[label])  # the order 2 is not there
    assert not is_changed(own[label], gear(100.0, 2.0)[label])


def growth(by, per_kelvin):
    """A link that grows by ``per_kelvin`` of one thermometer, the only effect of its set."""
    part = DescribedPart("frame", 2, 0, (linear(by),))
    candidate = plain_effect("thermal_growth", ["link2"], by, [part], {"link2.growth_mm_per_K": 0.02})
    member = SimpleNamespace(candidate=candidate, hyper=None, label="thermal_growth:link2")
    return by_effect(EffectSet((member,), np.array([per_kelvin]), np.array([[1e-8]])))


def test_what_grows_per_kelvin_of_the_arm_is_not_averaged_with_what_grows_per_kelvin_of_the_air():
    """The air warms by a seventh of what the arm does: the same growth, seven times the figure."""
    label, key = "thermal_growth:link2", "link2.growth_mm_per_K"
    arm, air = growth("robot_C", 0.003), growth("air_C", 0.021)
    reported = {key: ParameterEstimate(0.003, 1e-4)}
    alone = averaged(label, reported, arm, [(1.0, arm), (0.5, air)])
    assert alone[key].value == pytest.approx(0.003)
    assert alone[key].std == pytest.approx(1e-4)
    assert not any(is_changed(arm[label], other[label]) for other in (arm, air))
    both = averaged(label, reported, arm, [(1.0, arm), (1.0, growth("robot_C", 0.005))])
    assert both[key].value == pytest.approx(0.004)


def test_what_a_payload_states_of_a_compliance_is_averaged_with_what_the_joint_states():
    """The tool is heavier than declared: without it A3 seems softer than it is, by ten times the uncertainty of that set."""
    label, key = "joint_compliance:A3", "A3.compliance_rad_per_Nm"
    part = DescribedPart("joint", 2, 0, (linear("gravity_torque_3"),))
    candidate = plain_effect("payload", ["mount"], "gravity_torque_2", [part], {key: 1.5e-6})
    member = SimpleNamespace(candidate=candidate, hyper=None, label="payload:mount")
    heavy = by_effect(EffectSet((member,), np.array([4.0e-6]), np.array([[1e-14]])))
    alone = {label: {key: ParameterEstimate(4.6e-6, 5e-8)}}
    found = averaged(label, alone[label], alone, [(0.1, alone), (0.9, heavy)])[key]
    assert found.value == pytest.approx(4.06e-6)
    assert found.std == pytest.approx(np.sqrt(0.1 * 0.05**2 + 0.9 * 0.1**2 + 0.09 * 0.6**2) * 1e-6, rel=0.01)


def test_a_value_is_changed_beyond_its_expanded_uncertainty():
    own = stated(0.2, 0.02)[LABEL]
    assert is_changed(own, stated(0.25, 0.3)[LABEL])
    assert not is_changed(own, stated(0.23, 0.001)[LABEL])


def test_the_average_over_sizes_of_one_effect_is_that_of_its_posterior():
    """One coefficient with a prior of three widths, integrated numerically."""
    information, right, sizes = 40.0, 30.0, np.array([0.1, 1.0, 10.0])
    x = np.linspace(-3.0, 3.0, 200_001)
    likelihood = np.exp(right * x - 0.5 * information * x**2)
    prior = np.mean([np.exp(-0.5 * (x / s) ** 2) / s for s in sizes], axis=0)
    density = likelihood * prior / np.sum(likelihood * prior)
    A, a = np.array([[information]]), np.array([right])
    _, chosen = log_set_bayes_factor(A, a, [slice(0, 1)], [sizes], [False])
    mean, covariance = over_sizes(A, a, [slice(0, 1)], [sizes], chosen, [False])
    assert mean[0] == pytest.approx(float(density @ x), rel=1e-3)
    assert covariance[0, 0] == pytest.approx(float(density @ x**2 - (density @ x) ** 2), rel=1e-3)


@dataclass(frozen=True)
class Named:
    name: str
    where: tuple[str, ...] = ("A2",)
    rarity: float = 1.0
    usual: PriorOdds | None = None

    @property
    def label(self) -> str:
        return f"{self.name}:{'+'.join(self.where)}"


def test_what_most_arms_of_a_class_have_beside_another_effect_has_its_own_odds():
    soft, plain = Named("soft"), Named("plain", ("A1",))
    spring = Named("spring", usual=PriorOdds(3.0, "soft:A2"))
    prior = SetPrior.of([soft, plain, spring], 1)
    alone, both = (prior.log_probability_of_set(s) for s in ([soft], [soft, spring]))
    assert both - alone == pytest.approx(np.log(3.0))
    assert prior.log_probability_of_set([spring, soft]) == pytest.approx(both)
    assert prior.log_probability(spring, [soft]) == pytest.approx(np.log(3.0))
    # Without what it shows through it is as rare as any other effect.
    assert prior.log_probability_of_set([spring]) == pytest.approx(prior.log_probability_of_set([plain]))
    # An effect that is given counts as there.
    known = SetPrior.of([plain, spring], 1, ["soft:A2"])
    assert known.log_probability(spring, []) == pytest.approx(np.log(3.0))


def test_sets_that_differ_by_unmodelled_effects_alone_are_no_others_where_these_stand_at_all_locations():
    def compared(*effects):
        members = tuple(SimpleNamespace(candidate=Named(*effect), label=Named(*effect).label) for effect in effects)
        return SimpleNamespace(members=members, labels=frozenset(m.label for m in members), log_posterior=0.0, key=())

    gear, soft = ("gear_transmission_error",), ("joint_compliance",)
    here, there = ("unknown", ("A4",)), ("unknown", ("A1",))
    reported, elsewhere, named = compared(gear, here), compared(gear, there), compared(soft, here)
    fit = SimpleNamespace(hypotheses=(reported, elsewhere, named), significant=False)
    assert [h for h, _ in alternatives_to(fit, reported)] == [elsewhere, named]
    assert [h for h, _ in alternatives_to(fit, reported, everywhere=True)] == [named]
