"""No number of a plan or of a file that it names can be one that no cell has: each is refused with its file, line and key."""

import shutil
from pathlib import Path

import pytest

from mbcacq.errors import ConfigError
from mbcacq.model import yaml12
from mbcacq.model.bounds import BOUNDS
from mbcacq.model.cell_schema import ArtefactSpec, CellSpec, RobotSpec
from mbcacq.plan.loader import load
from mbcacq.plan.schema import Plan

PLANS = Path(__file__).resolve().parents[2] / "plans"
OF_DRIVERS = {"options", "fake"}  # checked by their own models


def numbers(data, path=()):
    """(path, value) of every number, the first of each list of lists standing for all."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key not in OF_DRIVERS:
                yield from numbers(value, (*path, key))
    elif isinstance(data, list):
        for index, value in enumerate(data[:1]):
            yield from numbers(value, (*path, index))
    elif isinstance(data, int | float) and not isinstance(data, bool):
        yield path


def changed(data, path, value):
    for key in path[:-1]:
        data = data[key]
    data[path[-1]] = value


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("desk")
    shutil.copytree(PLANS, folder / "plans")
    return folder / "plans"


def places():
    plan = yaml12.load((PLANS / "kuka.yaml").read_text())
    for name in ("kuka.yaml", plan["robot"]["model"], plan["artefacts"][0]):
        yield from ((name, path) for path in numbers(yaml12.load((PLANS / name).read_text())))


@pytest.mark.parametrize("value", [1e20, -1e308])
@pytest.mark.parametrize(("name", "path"), list(places()), ids=lambda part: part if isinstance(part, str) else ".".join(map(str, part)))
def test_a_number_that_no_cell_has_is_refused_where_it_stands(desk, name, path, value):
    before = (desk / name).read_text()
    data = yaml12.load(before)
    changed(data, path, value)
    (desk / name).write_text(yaml12.dump(data))
    key = next(str(part) for part in reversed(path) if isinstance(part, str))
    try:
        with pytest.raises(ConfigError, match=rf"{Path(name).name}:\d+: .*{key}"):
            load(desk / "kuka.yaml")
    finally:
        (desk / name).write_text(before)


UNITS = ("_mm", "_deg", "_kg", "_C", "_ppm_per_K", "_deg_s", "_deg_s2", "_deg_s3", "_s", "_us")


def bare(schema):
    """Whether a JSON schema permits a number without bounds."""
    if schema.get("type") == "number":
        return not {"minimum", "exclusiveMinimum"} & set(schema) or not {"maximum", "exclusiveMaximum"} & set(schema)
    parts = [*schema.get("anyOf", ()), *schema.get("prefixItems", ())]
    return any(bare(part) for part in [*parts, *([schema["items"]] if isinstance(schema.get("items"), dict) else [])])


def test_every_quantity_with_a_unit_has_bounds():
    found = set()
    for kind in (Plan, RobotSpec, ArtefactSpec, CellSpec):
        schema = kind.model_json_schema()
        for name, part in {kind.__name__: schema, **schema["$defs"]}.items():
            found |= {(name, key) for key, value in part.get("properties", {}).items() if key.endswith(UNITS) and bare(value)}
    assert found == set()


def test_every_range_of_the_table_is_one_and_says_why():
    assert all(bound.low < bound.high and bound.unit and len(bound.reason) > 10 for bound in BOUNDS.values())
