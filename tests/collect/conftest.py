from __future__ import annotations

import shutil

import pytest
from session import loaded, play, program_of, written_plan

import mbcacq


@pytest.fixture(scope="session")
def rehearsed(made_once):
    """Folder with plan.yaml, its program and the clouds of a session without mistakes; to be looked at only."""

    def make(folder):
        plan = written_plan(folder)
        play(plan, program_of(plan, folder / "program"), folder / "clouds")

    return made_once("rehearsed-session", make)


@pytest.fixture(scope="session")
def collected(rehearsed, made_once):
    """collected(with_table): folder with the clouds, the program's table beside them or not, and the run of them; to be looked at only."""

    def make(folder, with_table):
        shutil.copytree(rehearsed / "clouds", folder / "clouds", copy_function=shutil.copy2)
        (folder / "clouds" / "poses.csv").unlink(missing_ok=True)
        if with_table:
            shutil.copy(rehearsed / "program" / "poses.csv", folder / "clouds")
        mbcacq.collect(loaded(rehearsed / "plan.yaml"), folder / "clouds", out=folder / "run")

    return lambda with_table: made_once(f"collected-session-{with_table}", lambda folder: make(folder, with_table))


@pytest.fixture
def clouds(rehearsed, tmp_path):
    """The clouds, to be changed."""
    shutil.copytree(rehearsed / "clouds", tmp_path / "clouds", copy_function=shutil.copy2)
    return tmp_path / "clouds"
