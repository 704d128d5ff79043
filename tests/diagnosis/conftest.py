"""A simulated plan that makes every effect observable, shared by the tests of this folder."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def plan():
    """48 poses at six places of an artefact and two of a bar: as few as show what most tests of this folder state."""
    import simulated

    return simulated.plan(6, 2, 6)


@pytest.fixture(scope="session")
def medium_plan():
    """66 poses, for effects of two angles, for what is judged on places left out, and for noise that differs between poses."""
    import simulated

    return simulated.plan(7, 4, 6)


@pytest.fixture(scope="session")
def large_plan():
    """120 poses, for effects that are weaker and for what a time or a travel must be long for."""
    import simulated

    return simulated.plan()


@pytest.fixture(scope="session")
def elastic_arm(plan, computed_once):
    """The diagnosis of an arm with an elastic joint A2."""
    import simulated

    from mbcacq.diagnosis.diagnose import diagnose

    observed = simulated.observe(plan, 21, [("joint_compliance", ("A2",), [2.5e-6], None)])
    return computed_once("elastic-arm", lambda: diagnose(observed, folds=2))
