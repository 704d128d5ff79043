"""What an effect of the catalogue needs besides its own file, in sentences; and that nothing outside of ``mbcacq/effects`` knows it by name."""

import ast
import re
from pathlib import Path

import pytest
from cases import CASES
from mbcacq_fakes.dynamics.faults import FAULTS
from mbcacq_fakes.effects import CATALOGUED as INJECTED
from motion_challenge import catalogued_in_motion

from mbcacq.challenge.scenarios import catalogued
from mbcacq.effects import catalogue

ROOT = Path(__file__).parents[2]
NAMES = tuple(catalogue.effects())
IN_POSES = tuple(name for name, module in catalogue.effects().items() if hasattr(module, "candidates"))
IN_MOTION = tuple(
    name
    for name, module in catalogue.effects().items()
    if hasattr(module, "motion_candidates") or catalogue.declaration(name).periodic_in_motion is not None
)
# Effects of an instrument with orientations, of an arm that does not stop, of external axes: the challenge's cells have none of them.
NO_CHALLENGE = {"orientation_bias", "exposure_latency", "axis_error_motion"}
CHECKED_ELSEWHERE = {"orientation_bias": "test_orientation_bias.py", "axis_error_motion": "test_axis_error_motion.py"}
# Words of other things too: the tool that a cell declares, the body, the block and the signal of that name.
OTHER_THINGS = {"payload", "friction"}


def rows_of(page: str, name: str) -> list[str]:
    """The rows of the tables of a page that are of an effect."""
    lines = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith("|") and f"`{name}`" in line.split("|")[1]]


@pytest.mark.parametrize("name", IN_POSES)
def test_an_effect_in_poses_is_complete(name):
    rows = rows_of("effects", name)
    checked = name in {case.name for case in CASES} or name in CHECKED_ELSEWHERE
    injected = name in (*INJECTED, *CHECKED_ELSEWHERE)
    drawn = name in catalogued() or name in NO_CHALLENGE
    fakes = "fakes/mbcacq_fakes/effects"
    lacking = {
        f"docs/effects.md has no row for {name}: add one to the table of the catalogue": not rows,
        f"nothing checks {name} without code of the tool: add its physics in plain numpy and a Case to tests/effects/cases.py": not checked,
        f"no fake injects {name}: add {fakes}/{name}.py, written without a look at the effect, and its name to CATALOGUED of {fakes}/__init__.py": not injected,
        f"docs/fakes.md has no row for {name}: say how its fake simulates it, and its options": name in INJECTED
        and not rows_of("fakes", name),
        f"no challenge draws {name}: declare DECLARED = Declaration(challenge=Challenge(number={len(catalogued()) + 1})) in its file": not drawn,
    }
    assert not any(lacking.values()), "\n".join(sentence for sentence, lacks in lacking.items() if lacks)


@pytest.mark.parametrize("name", IN_MOTION)
def test_an_effect_in_motion_is_complete(name):
    page = (ROOT / "docs" / "reference" / "motion-effects.md").read_text(encoding="utf-8")
    further = f"Declaration(challenge=Challenge(in_motion={len(catalogued_in_motion()) + 1}))"
    lacking = {
        f"docs/reference/motion-effects.md does not name {name}: add it to the table of effects": f"`{name}`" not in page,
        f"no moving fake arm injects {name}: add it to FAULTS of fakes/mbcacq_fakes/dynamics/faults.py": name not in FAULTS,
        f"no challenge in motion draws {name}: declare DECLARED = {further} in its file": name not in catalogued_in_motion(),
    }
    assert not any(lacking.values()), "\n".join(sentence for sentence, lacks in lacking.items() if lacks)


def test_the_numbers_of_challenges_are_those_of_one_effect_each():
    declared = [c for name in NAMES if (c := catalogue.declaration(name).challenge) is not None]
    for numbers in ([c.number for c in declared if c.number], [c.in_motion for c in declared if c.in_motion]):
        given = sorted(numbers)
        assert given == list(range(1, len(given) + 1)), f"challenges are numbered without a gap, each effect once: {given}"


def test_an_effect_that_shows_through_or_refines_another_names_one_of_the_catalogue():
    for name in NAMES:
        declared = catalogue.declaration(name)
        assert declared.coupling is None or (declared.coupling.name == name and declared.coupling.through in NAMES)
        assert declared.refines is None or declared.refines.of in NAMES
        assert declared.challenge is None or set(declared.challenge.companions) <= set(NAMES)


def test_no_module_outside_of_the_effects_knows_one_by_name():
    word = re.compile(rf"({'|'.join(NAMES)})(:.*)?")
    found = []
    for path in (ROOT / "mbcacq").rglob("*.py"):
        if path.is_relative_to(ROOT / "mbcacq" / "effects"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mbcacq.effects.kinds"):
                found.append(f"{path.relative_to(ROOT)} imports {node.module}")
            elif isinstance(node, ast.ImportFrom) and node.module == "mbcacq.effects" and "kinds" in {a.name for a in node.names}:
                found.append(f"{path.relative_to(ROOT)} imports the effects")
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and word.fullmatch(node.value):
                if node.value not in OTHER_THINGS:
                    found.append(f"{path.relative_to(ROOT)}: '{node.value}'")
    assert found == []
