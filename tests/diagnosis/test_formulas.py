"""Formulas for unmodelled effects: a concealed one is recovered, its draft is an effect of the catalogue, noise gives none."""

import tomllib
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.formulas.propose import holds_up, located, propose, refused
from mbcacq.diagnosis.formulas.search import FormulaSearch, FormulaSpace
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore
from mbcacq.diagnosis.verdict import verdict_of
from mbcacq.effects import catalogue
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.errors import ConfigError
from mbcacq.estimation.forward_model import Displacements
from mbcacq.estimation.variance_components import pack
from mbcacq.workflow.effect_draft import write_draft

PULL = 1.2e-4


def pull_by_another_angle(s):
    """Joint 1 is pulled aside by the sine of twice the third angle."""
    joint = np.zeros(s.obs.q.shape)
    joint[:, 0] = PULL * np.sin(2 * s.obs.q[:, 2])
    return Displacements(joint=joint)


def hose_between_two_angles(s):
    """Joint 5 is pulled aside by the product of two sines."""
    joint = np.zeros(s.obs.q.shape)
    joint[:, 4] = PULL * np.sin(s.obs.q[:, 3]) * np.sin(s.obs.q[:, 1])
    return Displacements(joint=joint)


def found_at(where, on):
    return EffectFound(name=UNKNOWN, where=(where,), parameters={}, p_value=0.0, held_out_gain=1.0, depends_on=on)


def terms_at(problem, places):
    return FormulaSpace.of(problem.context, located(problem.context, places))


def plain_noise(problem):
    return NoisePoint(problem.linear, problem.prior_noise, pack(problem.noise))


@pytest.fixture(scope="module")
def short():
    """72 poses: fewer than those of the other tests, for time."""
    return simulated.plan(6, 3)


@pytest.fixture(scope="module")
def recording(short):
    return simulated.observe(short, 31, [pull_by_another_angle])


@pytest.fixture(scope="module")
def proposals(recording):
    problem = prepare(recording)
    full = model_fit.fit_model(problem)
    return propose(problem, full, [found_at(cell.location, cell.depends_on) for cell in full.cells])[0]


def test_the_concealed_formula_is_the_most_probable(proposals):
    best = proposals[0]

    assert (best.where, best.terms) == (("A1",), ("2q3",))
    assert best.term.names == ("A1.sin_2q3_rad",)
    assert abs(best.term.coefficients[0] - PULL) < 4 * best.term.std[0]
    assert best.found_in == best.parts
    assert best.held_out_chi2_dof < 1.2 < best.held_out_before_chi2_dof


def test_a_product_of_two_angles_is_found(short):
    problem = prepare(simulated.observe(short, 33, [hose_between_two_angles]))

    search = FormulaSearch(plain_noise(problem), (), terms_at(problem, [found_at("link4", "q4")]))
    best = search.run(most_terms=1)[0]

    assert [p.label for p in best.placed] == ["A5(0,):q2*q4['sin(q2) sin(q4)']"]
    assert abs(best.hypothesis.solved.coefficients[0] - PULL) < 4 * np.sqrt(best.hypothesis.solved.covariance[0, 0])


def test_one_cube_is_preferred_to_a_pair_that_nearly_is_one(plan):
    """Strong beside the noise: under a noise that still contains it every further term seems to gain."""

    def progressive_gear(s):
        joint = np.zeros(s.obs.q.shape)
        torque = s.gravity_torque[:, 2]
        joint[:, 2] = 6e-4 * (torque / np.abs(torque).max()) ** 3
        return Displacements(joint=joint)

    problem = prepare(simulated.observe(plan, 33, [progressive_gear]))
    found = FormulaSearch(plain_noise(problem), (), terms_at(problem, [found_at("A3", "gravity_torque_3")])).run()
    assert [p.term.shape for p in found[0].placed] == ["gravity_torque_3^3"]
    count = Counter(len(f.placed) for f in found)
    assert min(count[1], count[2]) >= 3


def test_the_draft_is_found_by_its_name_and_explains_the_recording(proposals, recording, tmp_path):
    _, module = write_draft(proposals[:1], tmp_path / "draft")

    with catalogue.with_added([module]):
        found = model_fit.fit_model(prepare(recording))

    assert [m.candidate.location for m in found.model.members] == [("a1_by_q3", ("A1",))]
    assert verdict_of(found) == "explained"
    (value,), ((variance,),) = found.model.coefficients, found.model.covariance
    assert abs(value - PULL) < 4 * np.sqrt(variance)
    assert "a1_by_q3" not in catalogue.effects()


def test_the_package_of_a_draft_names_its_entry_point(proposals, tmp_path, monkeypatch):
    project, module = write_draft(proposals[:1], tmp_path / "draft")
    stated = tomllib.loads(project.read_text())
    points = stated["project"]["entry-points"]["mbcacq.effects"]
    info = project.parent / "draft-0.1.dist-info"  # as pip leaves it beside the module
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: draft\nVersion: 0.1\n")
    lines = [f"{name} = {target}" for name, target in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[mbcacq.effects]", *lines, ""]))
    monkeypatch.syspath_prepend(str(project.parent))

    assert stated["tool"]["setuptools"]["py-modules"] == [module.stem]
    assert list(points.values()) == [module.stem]
    assert set(points) <= set(catalogue.effects())


def test_noise_gives_no_formula(short):
    problem = prepare(simulated.observe(short, 32))
    terms = terms_at(problem, [found_at("A2", "q2"), found_at("mount", "q6"), found_at("scanner", "x")])

    best = FormulaSearch(plain_noise(problem), (), terms).run(most_terms=1)[0]

    assert list(dict.fromkeys(p.location.name for p in terms.placed)) == ["A2", "mount", "A6", "scanner"]
    assert best.log_posterior < 0.0


def parts(*chi2):
    return [PredictiveScore(0.1, 100, float(c), 300.0) for c in chi2]


@pytest.mark.parametrize(
    ("formula", "found_in", "offered"),
    [
        ((300, 310, 295, 305), 4, True),  # as good as the smooth model
        ((300, 310, 340, 290), 3, True),  # worse in sum, within what the parts differ by
        ((500, 490, 505, 485), 4, False),  # chi2 1.65 against 1.02
        ((300, 310, 295, 305), 2, False),  # found in the data that it was sought in, and in half of the others
    ],
)
def test_a_formula_is_offered_where_it_holds_up_without_the_data_it_was_found_in(proposals, formula, found_in, offered):
    smooth = parts(305, 300, 310, 295)
    one = replace(proposals[0], found_in=found_in, parts=4, held_out_before_chi2_dof=3.0, held_out_chi2_dof=sum(formula) / 1200)

    assert holds_up(one, parts(*formula), smooth) is offered


def test_a_formula_that_is_not_offered_is_named_with_the_reason(proposals):
    said = refused(replace(proposals[0], found_in=0, parts=4, held_out_chi2_dof=1.65, smooth_chi2_dof=1.02))
    assert proposals[0].formula in said
    assert "χ²/dof 1.65, the smooth model with 1.02, and came again in 0 of 4 searches" in said


def test_proposals_survive_json(proposals):
    import dataclasses

    from test_result import FOUND

    content = dataclasses.replace(FOUND, proposals=proposals).to_json()
    again = Diagnosis.from_json(content)

    assert [p.formula for p in again.proposals] == [p.formula for p in proposals]
    assert again.to_json() == content


def test_a_draft_replaces_nothing(proposals, tmp_path):
    (tmp_path / "mine.py").write_text("x = 1\n")

    with pytest.raises(ConfigError, match="not empty"):
        write_draft(proposals, tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("NAME = 'a'", "needs NAME, and candidates"),
        ("import no_such_module", "no_such_module"),
        ("NAME = 'backlash'\ndef candidates(context):\n    return []", "called backlash, as another one is"),
    ],
)
def test_a_file_that_is_no_effect_is_refused_in_a_sentence(text, words, tmp_path):
    file = tmp_path / "effect.py"
    file.write_text(text)

    with pytest.raises(ConfigError, match=words), catalogue.with_added([file]):
        pass
