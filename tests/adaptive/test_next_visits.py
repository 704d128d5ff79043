"""What to measure next can be reached, decides what is open, and is measured; an investigation ends, and replays its decisions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.design.adaptive.backward_elimination import MeasuredInformation
from mbcacq.design.adaptive.first_block import first_block
from mbcacq.design.adaptive.investigation import Budget, Decision, decisions, sure
from mbcacq.design.adaptive.next_plan import choose_next, next_plan_text
from mbcacq.design.adaptive.options import AdaptiveOptions
from mbcacq.design.adaptive.places import accepted_places, errors_at
from mbcacq.design.adaptive.questions import SetComparison
from mbcacq.design.adaptive.visit_choice import predicted
from mbcacq.design.information_blocks import InformationBlocks
from mbcacq.diagnosis.interim import weigh
from mbcacq.diagnosis.output.next_measurements import errors_elsewhere
from mbcacq.model.json_text import fields_as_json, from_fields
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, expand, load
from mbcacq.plan.feasibility import check
from mbcacq.plan.schema import Acceptance, AcceptanceBox

PLAN = Path(__file__).parents[2] / "plans" / "concealed.yaml"
FEW = AdaptiveOptions(views_per_station=6, fewest=3, most=5)
QUIET = Scenario(0, "none", 7, (), 1, 0.0)
SCALE = [{"name": "joint_scale", "where": "A5", "strength": 3.0, "seed": 3}]


@pytest.fixture(scope="module")
def begun() -> LoadedPlan:
    return first_block(load(PLAN))


@pytest.fixture(scope="module")
def looked(begun):
    return weigh(observe(begun, expand(begun), QUIET, SCALE)[0])


def test_the_first_block_is_of_the_plans_own_poses_and_revisits_no_station(begun):
    own = [p for p in expand(load(PLAN)) if p.phase != "verification"]
    poses = expand(begun)
    assert len(poses) == begun.grown_from == 24
    assert all(min(np.abs(p.q - o.q).max() for o in own if o.station == p.station) < 1e-4 for p in poses)
    stations = [p.station for p in poses]
    assert len(dict.fromkeys(stations)) == 1 + sum(a != b for a, b in zip(stations, stations[1:], strict=False))


def test_the_next_poses_are_a_plan_without_errors_at_stations_of_the_cell(begun, looked, tmp_path):
    chosen = choose_next(looked, begun, visits=2, poses=10, options=FEW)
    assert 0 < len(chosen.poses) <= 10
    file = tmp_path / "next.yaml"
    file.write_text(next_plan_text(begun, chosen.visits, tmp_path, chosen.reasons), encoding="utf-8")
    further = load(file)
    poses = expand(further)
    assert [p.station for p in poses] == [p.station for p in chosen.poses]
    assert np.allclose([p.q for p in poses], [p.q for p in chosen.poses], atol=np.radians(1e-3))
    assert [f for f in check(further, poses) if f.level == "error" and f.poses] == []


def test_without_moves_only_stations_whose_artefact_stands_there_are_chosen(begun, looked):
    last = {s.artefact: s.id for s in (begun.cell.station(p.station) for p in expand(begun))}
    chosen = choose_next(looked, begun, visits=1, poses=6, moves=0, options=FEW)
    assert {v.station for v in chosen.visits} <= set(last.values())


def test_decisions_are_replayed_and_go_on_as_they_did(begun):
    def measure(grown: LoadedPlan) -> Observations:
        return observe(grown, expand(grown), QUIET, [])[0]

    def of(before: list[Decision]) -> list[Decision]:
        return list(decisions(load(PLAN), measure, Budget(poses=30), before))

    made = of([])
    assert made[-1].end
    assert all(not d.end for d in made[:-1])
    assert of([from_fields(Decision, fields_as_json(d)) for d in made[:1]]) == made


def test_a_recording_of_a_run_is_gone_on_with(begun):
    grown_plans: list[LoadedPlan] = []

    def measure(grown: LoadedPlan) -> Observations:
        grown_plans.append(grown)
        return observe(grown, expand(grown), QUIET, [])[0]

    recorded = observe(begun, expand(begun), QUIET, SCALE)[0]
    found = decisions(replace(begun, grown_from=24), measure, Budget(poses=27), measured=recorded)
    first = next(found)
    assert first.poses == 24
    if first.steps:
        assert next(found).poses == 24 + sum(len(step["poses_deg"]) for step in first.steps)
        assert grown_plans[0].grown_from == 24


def test_errors_at_the_places_of_a_plan_are_of_lengths_between_them(looked):
    """What moves all places as one rigid body is where the base is; what no view is near to says nothing."""
    linear = looked.problem.linear
    places = np.array([[600.0, 0.0, 150.0], [550.0, -300.0, 500.0], [560.0, -40.0, 150.0], [600.0, 40.0, 160.0]])
    rows = errors_at(places, linear)
    assert rows.shape == (12, linear.geometry.shape[2])
    assert np.abs(rows.reshape(4, 3, -1).sum(axis=0)).max() < 1e-6 * np.abs(rows).max()
    assert np.abs(rows).max() > 0.01
    assert errors_at(np.array([[5000.0, 0.0, 0.0]]), linear).shape == (0, linear.geometry.shape[2])


def test_a_box_stands_for_its_corners_and_its_middle():
    box = AcceptanceBox(min_mm=(0.0, 0.0, 0.0), max_mm=(2.0, 4.0, 6.0))
    places = accepted_places(Acceptance(box=box, places_mm=((9.0, 9.0, 9.0),)))
    assert len(places) == 10
    assert places[0].tolist() == [9.0, 9.0, 9.0]
    assert sorted(map(tuple, places[1:9].tolist())) == [(x, y, z) for x in (0.0, 2.0) for y in (0.0, 4.0) for z in (0.0, 6.0)]
    assert places[9].tolist() == [1.0, 2.0, 3.0]


def test_what_can_do_less_than_the_limit_of_the_user_does_not_hide(looked):
    hiding = looked.hiding()
    assert sum(hiding.values()) == pytest.approx(1.0 - looked.excluded)
    assert set(looked.hiding(limit_mm=1e9)) <= {e.label for e in looked.limited if errors_elsewhere(looked._there, e)[1] is None}
    assert set(looked.hiding(limit_mm=0.02)) <= set(hiding)


def test_what_geometry_explains_tells_no_sets_apart_and_what_chance_made_does_not_come_again():
    """Two fits that differ by the same change of geometry before and after predict the same. A fit that took up noise of the measured poses
    predicts differently wherever its effect acts."""
    rng = np.random.default_rng(4)
    Z, own = rng.normal(size=(30, 4, 5)), rng.normal(size=(30, 4, 1))
    E = np.concatenate([Z @ rng.normal(size=(5, 1)), 3.0 * own, own], axis=2)  # geometry; an effect as fitted, and by its column
    blocks = InformationBlocks(1e4 * Z, E)  # of a prior that is wide
    measured = MeasuredInformation.nothing(5, 3).with_poses(blocks.select(np.arange(10)))
    before, ahead = predicted(measured, blocks.select(np.arange(10, 30)), np.array([0, 1]))
    after = before.with_poses(ahead)
    assert before.squares[:2] == pytest.approx(0.0, abs=1e-9)
    assert after.squares[0] == pytest.approx(0.0, abs=1e-6)
    # If there is nothing, the effect's own coefficient, of prior one, follows the new poses only as far as the measured ones let it.
    a, b = measured.gram[2, 2], after.gram[2, 2]
    information = SetComparison(differs=1, model=(2,), weight=0.5, known=0.0, a=0, b=1).information(after.gram)
    assert information == pytest.approx(9.0 * (b - a) * (1.0 + a) / (1.0 + b), rel=1e-6)


def test_an_effect_that_may_be_chance_is_not_given_up_as_out_of_reach():
    """24 poses of an arm with elastic A2 and A3: odds of about 30 : 1 against no effect, which is neither; six more decide."""
    plan = first_block(load(Path(__file__).parents[2] / "plans" / "seeing.yaml"))
    elastic = [{"name": "joint_compliance", "strength": 1.0048221688047394, "seed": 1258493682}]
    look = weigh(observe(plan, expand(plan), Scenario(0, "joint_compliance", 730992690, (), 1, 1.0), elastic)[0])
    assert look.verdict == "cannot_tell"
    assert not look.full.evidence.significant
    chosen = choose_next(look, plan, visits=1, poses=10)
    assert not chosen.futile
    assert len(chosen.poses) >= 6
    assert {frozenset(pair.a) for pair in chosen.open_pairs} == {frozenset({"joint_compliance:A2", "joint_compliance:A3"})}  # most probable
    assert {(), ("unknown:A3",)} <= {pair.b for pair in chosen.open_pairs}


def test_a_search_does_not_end_with_none_while_an_effect_is_half_as_probable(begun):
    leaning = [{"name": "base_compliance", "strength": 0.5, "seed": 1}]
    look = weigh(observe(begun, expand(begun), QUIET, leaning)[0])
    assert look.verdict == "none"
    assert 0.5 < np.exp(look.full.evidence.log_e_value) < 1
    assert not sure(look)
    chosen = choose_next(look, begun, visits=1, poses=10, options=FEW)
    assert ((), ("base_compliance:base",)) in [(pair.a, pair.b) for pair in chosen.open_pairs]
    assert sure(weigh(observe(begun, expand(begun), QUIET, [])[0]))


def test_a_decision_has_the_same_figures_with_one_thread_of_linear_algebra_and_with_two(begun):
    obs, made = observe(begun, expand(begun), QUIET, [])[0], []
    for threads in (1, 2):
        with threadpool_limits(threads):
            made += list(decisions(begun, lambda grown: obs, Budget(poses=24), measured=obs))
    assert len(made) == 2
    assert made[0] == made[1]


def test_a_station_that_creeps_is_found_where_three_poses_see_it():
    """The first block visits p4 with three poses, while its tripod creeps."""
    plan = first_block(load(Path(__file__).parents[2] / "plans" / "seeing.yaml"))
    poses = expand(plan)
    assert sum(p.station == "p4" for p in poses) == 3
    creeping = [{"name": "station_drift", "station": "p4", "strength": 0.3, "seed": 5}]
    look = weigh(observe(plan, poses, Scenario(0, "station_drift", 11, ("station_drift",), 5, 1.0), creeping)[0])
    assert look.reported.labels == {"station_drift:stationp4"}
    assert look.verdict == "explained"
