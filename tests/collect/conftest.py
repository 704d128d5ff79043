from __future__ import annotations

import shutil

import pytest
from session import play, program_of, written_plan


@pytest.fixture(scope="session")
def rehearsed(made_once):
    """Folder with plan.yaml, its program and the clouds of a session without mistakes; to be looked at only."""

    def make(folder):
        plan = written_plan(folder)
        play(plan, program_of(plan, folder / "program"), folder / "clouds")

    return made_once("rehearsed-session", make)


@pytest.fixture
def clouds(rehearsed, tmp_path):
    """The clouds, to be changed."""
    shutil.copytree(rehearsed / "clouds", tmp_path / "clouds", copy_function=shutil.copy2)
    return tmp_path / "clouds"
