"""A file with effects that is damaged is refused where it is read, by file and key; one that holds none says why."""

from __future__ import annotations

import copy
import json
import re

import numpy as np
import pytest
import simulated

from mbcacq.cli import tables
from mbcacq.diagnosis.output.kept_model import term_of
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects import catalogue, unmodelled
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import LearntRecording
from mbcacq.errors import ConfigError
from mbcacq.estimation import forward_model
from mbcacq.workflow.effects import as_effects, remarks_on_names

PYTHON = re.compile(r"NoneType|KeyError|TypeError|ValueError|Expecting|codec|subscriptable|broadcast|IndexError|_[A-Z]|format None")
COLUMN = ("terms", 0, "parts", 0, "columns", 0, 0)


@pytest.fixture(scope="module")
def content(plan):
    """A diagnosis of a six-axis arm with the compliance of A2 and an unmodelled effect of its base."""
    state = simulated.nominal_state(plan)
    context = Context(plan, state, forward_model.predict(plan, state))
    soft = next(c for c in catalogue.candidates(context)[0] if c.name == "joint_compliance" and c.where == ("A2",))
    base = unmodelled.group(Covariates(plan), "base", "gravity_torque_2")
    assert base is not None
    terms = (term_of(context, soft, None, np.array([2e-6]), np.array([1e-7])), base)
    return {"format": "mbcacq-diagnosis/1", "fit": {}, "model": EffectModel(plan.cell.robot, terms, LearntRecording.of(plan)).to_dict()}


def _written(tmp_path, content):
    file = tmp_path / "found.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    return file


def test_whole_effects_are_read(content, tmp_path):
    assert [t.name for t in as_effects(_written(tmp_path, content)).terms] == ["joint_compliance", "unknown"]


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        (("terms", 0, "parts", 0, "index"), 42, "42 is not within 0 to 5"),
        (("terms", 0, "parts", 0, "index"), -1, "-1 is not within 0 to 5"),
        (("terms", 1, "parts", 0, "index"), 7, "7 is not within 0 to 6"),
        (("terms", 1, "parts", 0, "component"), 6, "6 is not within 0 to 5"),
        (("terms", 0, "parts", 0, "place"), "nowhere", "'nowhere' is none of"),
        (("terms", 0, "parts", 0, "columns"), [], "0 columns for 1 coefficients"),
        (("terms", 0, "parts"), [], "it has too few entries"),
        (("terms", 0, "where", 0), "A9", "there is no A9 on an arm of 6 axes"),
        (("terms", 0, "where", 0), "link7", "there is no link7 on an arm of 6 axes"),
        (("terms", 0, "coefficients", 0), None, "it is no number"),
        (("terms", 0, "coefficients"), [1.0, 2.0], "2 values for 1 coefficients"),
        (("terms", 0, "coefficients", 0), float("nan"), "it is not finite"),
        (("terms", 0, "sigma", 0), 0.0, "must be larger than zero"),
        (("terms", 0, "hyper"), {"order": "x"}, "it is no number"),
        (("terms", 0, "depends_on"), None, "it is no text"),
        ((*COLUMN, "functions", 0, "of"), "gravity_torque_9", "there is no gravity_torque_9 on an arm of 6 axes"),
        ((*COLUMN, "functions", 0, "kind"), "bessel", "there is no function 'bessel'"),
        ((*COLUMN, "functions", 0, "numbers"), [], "'power' has 1 numbers, here are 0"),
        ((*COLUMN, "functions", 0), {"of": "q2", "kind": "tanh", "numbers": [0.0]}, "'tanh' has no finite value"),
        (("robot",), None, "it is no object of keys and values"),
        (("robot", "nominal", "theta"), [1, 2], "2 values for 6 axes"),
        (("learnt",), [], "it is no object of keys and values"),
    ],
)
def test_a_damaged_value_is_named_by_file_and_key(content, tmp_path, path, value, sentence):
    changed = copy.deepcopy(content)
    *above, last = path
    at = changed["model"]
    for key in above:
        at = at[key]
    at[last] = value
    with pytest.raises(ConfigError, match=re.escape(sentence)) as error:
        as_effects(_written(tmp_path, changed))
    said = str(error.value)
    assert re.search(rf"found\.json( is damaged \(|: )model\.{re.escape('.'.join(map(str, path)))}", said)
    assert not PYTHON.search(said.replace(str(tmp_path), ""))


@pytest.mark.parametrize("key", ["robot", "learnt", "terms", "measurement"])
def test_a_missing_key_is_named(content, tmp_path, key):
    model = {k: v for k, v in content["model"].items() if k != key}
    with pytest.raises(ConfigError, match=rf"found\.json is damaged \(the key 'model\.{key}' is missing\)"):
        as_effects(_written(tmp_path, content | {"model": model}))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": None}, "does not say its format"),
        ({"format": "mbcacq-plan/1"}, "is of format 'mbcacq-plan/1', and no diagnosis"),
        ({"fit": {"channels": []}, "model": None}, "is the diagnosis of a motion"),
        ({"model": None}, "its 'model' is empty or missing"),
        ({"model": {"terms": []}}, "model.terms is empty"),
        ({"model": {"format": "mbcacq-effect-model/9"}}, "model was written by a newer mbcacq"),
        ({"model": {"format": "mbcacq-plan/1"}}, "model is no model of effects of format 'mbcacq-effect-model/1'"),
    ],
)
def test_a_file_without_effects_says_why(content, tmp_path, change, sentence):
    model = content["model"] | change["model"] if change.get("model") else change.get("model", content["model"])
    with pytest.raises(ConfigError, match=re.escape(sentence)) as error:
        as_effects(_written(tmp_path, content | change | {"model": model}))
    assert "found.json" in str(error.value)
    assert not PYTHON.search(str(error.value).replace(str(tmp_path), ""))


@pytest.mark.parametrize(
    ("data", "fault"), [(b"", "it is empty"), (b"{", "it breaks off"), (b"\xff", "it is not UTF-8 text"), (b"[" * 100_000, "its brackets")]
)
def test_what_is_no_json_is_said_in_words(tmp_path, data, fault):
    file = tmp_path / "found.json"
    file.write_bytes(data)
    with pytest.raises(ConfigError, match=re.escape(f"found.json is not JSON ({fault}")):
        as_effects(file)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": None}, "is no diagnosis of format 'mbcacq-diagnosis/3'"),
        ({"format": "x"}, "is no diagnosis of format 'mbcacq-diagnosis/3'"),
        ({}, "the key 'verdict' is missing"),
        ({"verdict": "x", "mismatch": None}, "mismatch: it is no list"),
    ],
)
def test_a_diagnosis_that_is_none_says_why(content, change, sentence):
    with pytest.raises(ConfigError, match=sentence):
        Diagnosis.from_json(content | change)


@pytest.mark.parametrize(
    ("names", "remarks"),
    [
        (["joint_compliance", "unknown"], []),
        (["joint_complaince", "joint_complaince"], ["(is 'joint_compliance' meant?): it is taken as its file describes it"]),
        (["hose_pull"], ["the effect 'hose_pull' is not in the catalogue here: it is taken"]),
    ],
)
def test_a_name_that_the_catalogue_lacks_is_remarked(names, remarks):
    """An effect of another package needs no package to be evaluated, so it is used; a slip must be seen."""
    said = remarks_on_names(names)
    assert len(said) == len(remarks)
    assert all(part in sentence for part, sentence in zip(remarks, said, strict=True))


def test_the_remark_is_printed_with_the_effects(content):
    model = copy.deepcopy(content["model"])
    model["terms"][0]["name"] = "joint_complaince"
    assert any("is 'joint_compliance' meant?" in line for line in tables.effects({"effects": model}))
