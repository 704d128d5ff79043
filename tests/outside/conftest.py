"""The example package on the path of this process."""

import sys

import pytest
from installed_package import install


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    return install(tmp_path_factory.mktemp("site"))


@pytest.fixture
def outside(site, monkeypatch):
    monkeypatch.syspath_prepend(str(site))
    yield site
    for name in [name for name in sys.modules if name.split(".")[0] == "acme_probe"]:
        del sys.modules[name]
