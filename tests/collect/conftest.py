from __future__ import annotations

import shutil

import pytest
from session import play, program_of, written_plan


@pytest.fixture(scope="session")
def rehearsed(tmp_path_factory):
    """Folder with plan.yaml, its program and the clouds of a session without mistakes."""
    folder = tmp_path_factory.mktemp("session")
    plan = written_plan(folder)
    play(plan, program_of(plan, folder / "program"), folder / "clouds")
    return folder


@pytest.fixture
def clouds(rehearsed, tmp_path):
    """The clouds, to be changed."""
    shutil.copytree(rehearsed / "clouds", tmp_path / "clouds", copy_function=shutil.copy2)
    return tmp_path / "clouds"
