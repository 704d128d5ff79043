"""A small plan in a folder of its own."""

import pytest
from plan_folder import Folder


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)
