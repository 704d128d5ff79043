"""Candidates scored many at a time have the evidence that each has by itself."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.evidence.candidate_evidence import evidence_of_candidates, evidence_of_one
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.bayes_factor import eigenvalues
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring


@pytest.fixture(scope="module")
def setup(plan):
    return prepare(simulated.observe(plan, 161, [("joint_compliance", ("A2",), [2e-6], None), ("joint_scale", ("A5",), [3e-4], None)]))


@pytest.mark.parametrize("effects", [(), (("joint_compliance", "A2"),), (("joint_compliance", "A2"), ("joint_scale", "A5"))])
def test_evidence_of_a_batch_equals_that_of_each_candidate_alone(setup, effects):
    projected = CandidateScoring.of(setup.linear, setup.noise)
    chosen = [next(c for c in setup.candidates if (c.name, c.where[0]) == m) for m in effects]
    here = projected.conditioned_on([(projected.block(c, None), np.zeros(c.k)) for c in chosen])

    together = {member.candidate.key: log for log, member in evidence_of_candidates(here, setup.candidates)}

    single = [c for c in setup.candidates if not c.components and c.hyper is None]
    assert len(single) > 40
    apart = [evidence_of_one(here, c)[0] for c in single]
    np.testing.assert_allclose([together[c.key] for c in single], apart, rtol=1e-7, atol=1e-7)


def test_two_by_two_in_closed_form():
    rng = np.random.default_rng(3)
    X = rng.normal(size=(500, 20, 2)) * [1.0, 30.0]
    X[:5, :, 1] = 0.0
    S, b = np.swapaxes(X, 1, 2) @ X, rng.normal(size=(500, 2))

    values, along = eigenvalues(S, b)

    np.testing.assert_allclose(values, np.linalg.eigvalsh(S), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        np.sum(along[5:] ** 2 / values[5:], axis=1), np.einsum("hi,hij,hj->h", b[5:], np.linalg.inv(S[5:]), b[5:]), rtol=1e-8
    )
