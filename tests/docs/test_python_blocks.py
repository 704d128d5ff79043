"""Every Python block of README and docs is executed: the blocks of a page in their order, as a reader would paste them.

The tutorials are executed by tests/library/test_tutorial.py, the effect model by test_effect_model_page.py, against what they promise.
"""

from __future__ import annotations

import contextlib
import re
import socketserver
from collections.abc import Iterator
from pathlib import Path

import pytest
from doc_pages import ROOT, Page, pages
from mbcacq_fakes.cell.ports import free_port

import mbcacq
from mbcacq.exports.result_json import load_result
from mbcacq.recording.datasets.observation_set import write_observation_set

BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
ELSEWHERE = {"docs/reference/effect-model.md", *(f"docs/tutorials/{n}.md" for n in ("library", "plan-for-your-arm", "add-an-effect"))}
WITH_BLOCKS = [page for page in pages() if BLOCK.search(page.text)]


@pytest.fixture
def desk(finished_run, tmp_path, monkeypatch) -> Path:
    """A folder with the shipped plans, and a run that was finished today."""
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "today").symlink_to(finished_run("quick.yaml").folder)
    (tmp_path / "plans").symlink_to(ROOT / "plans")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@contextlib.contextmanager
def what_the_page_takes_for_granted(page: Page, desk: Path) -> Iterator[dict]:
    """Names that stand for something of the reader's, as the text in front of the block says."""
    if page.name == "docs/conformance.md":
        with socketserver.TCPServer(("127.0.0.1", 0), socketserver.StreamRequestHandler) as server:
            yield {"device": server.server_address}
    elif page.name == "docs/reference/gocator.md":
        yield {"frame": None}
    elif page.name == "docs/how-to/data-from-another-lab.md":
        mbcacq.export(desk / "runs" / "today", observations=desk / "my-set")
        yield {}
    elif page.name == "docs/fakes.md":
        from mbcacq.plan import expand, load

        loaded = load(desk / "plans" / "quick.yaml")
        yield {"loaded": loaded, "poses": expand(loaded)}
    elif page.name == "docs/report.md":
        run = desk / "runs" / "today"
        yield {"observations": mbcacq.load_observations(run), "result": load_result(run)}
    elif page.name == "docs/write-a-driver.md":
        with pytest.MonkeyPatch.context() as patched:
            patched.syspath_prepend(str(ROOT / "tests" / "outside" / "acme_probe_package"))
            yield {}
    elif page.name == "README.md":
        (desk / "runs" / "today").unlink()
        write_observation_set(mbcacq.simulate(desk / "plans" / "kuka.yaml", noise=True, seed=1), desk / "runs" / "today")
        yield {}
    else:
        yield {}


def with_free_ports(block: str) -> str:
    """The block with ports that no other program of this computer has."""
    return re.sub(r"(?<=_port=)\d+", lambda _: str(free_port()), block)


def test_no_page_with_python_is_forgotten():
    assert {page.name for page in WITH_BLOCKS} >= ELSEWHERE


@pytest.mark.parametrize("page", [p for p in WITH_BLOCKS if p.name not in ELSEWHERE], ids=lambda page: page.name)
def test_the_python_of_a_page_runs(page, desk):
    with what_the_page_takes_for_granted(page, desk) as names:
        for block in BLOCK.findall(page.text):
            exec(compile(with_free_ports(block), page.name, "exec"), names)  # noqa: S102 -- our own pages
