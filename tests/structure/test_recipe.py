"""The recipe of the conda package states what pyproject.toml states: version, build and dependencies."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
RECIPE = yaml.safe_load((ROOT / ".ci" / "recipe.yaml").read_text(encoding="utf-8"))
CONDA_NAMES = {"msgpack": "msgpack-python", "mujoco-core": "mujoco-python", "open3d-cpu": "open3d", "libusb-package": "libusb"}


def as_conda(requirement):
    """(name, versions) of a requirement; its marker is left out, for a recipe is of one system."""
    name, versions = re.fullmatch(r"([\w-]+)\s*([<>=!~\d.,]*)", requirement.partition(";")[0].strip()).groups()
    return CONDA_NAMES.get(name, name), "" if name == "libusb-package" else versions


def stated(section):
    """{name: versions} of a section of the recipe."""
    return {name: versions for name, _, versions in (line.partition(" ") for line in RECIPE["requirements"][section])}


def test_name_and_version():
    assert RECIPE["package"]["name"] == PROJECT["project"]["name"]
    assert RECIPE["context"]["version"] == PROJECT["project"]["version"]


def test_dependencies():
    wanted = dict(map(as_conda, PROJECT["project"]["dependencies"])) | {"python": PROJECT["project"]["requires-python"]}
    assert stated("run") == wanted


def test_what_builds_it():
    wanted = dict(map(as_conda, PROJECT["build-system"]["requires"])) | {"python": PROJECT["project"]["requires-python"], "pip": ""}
    assert stated("host") == wanted
