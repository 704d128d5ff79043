"""A package that is none of ours registers an entry point and works as our own drivers do: listed, checked, run, tested by the suite."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from dry_runs import few_views, plan_file
from installed_package import PACKAGE, install

from mbcacq.cli.app import app
from mbcacq.conformance import CHECKS, check
from mbcacq.errors import ConfigError

ROOT = Path(__file__).parents[2]


def mbcacq(site, *arguments):
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run(
        [Path(sys.executable).parent / "mbcacq", *map(str, arguments)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=900,
        stdin=subprocess.DEVNULL,
    )


def listed(site):
    done = mbcacq(site, "drivers", "--json")
    assert done.returncode == 0, done.stderr
    return {(d["kind"], d["name"]): d for d in json.loads(done.stdout)["drivers"]}


def test_it_is_listed_with_its_package_beside_ours(site):
    drivers = listed(site)
    ours = drivers["sensors", "acme_probe"]
    assert (ours["package"], ours["version"], ours["problem"]) == ("acme-probe", "1.2", "")
    assert ours["tried"] == "T-1000, by the author"
    assert drivers["robots", "kuka_rsi"]["tried"] == ""
    text = mbcacq(site, "drivers").stdout
    assert re.search(r"sensors +acme_probe +acme-probe 1\.2 +yes +T-1000, by the author", text)
    assert re.search(r"robots +kuka_rsi +mbcacq \S+ +yes +not yet", text)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import no_such_library\n", "cannot be imported: ModuleNotFoundError: No module named 'no_such_library'"),
        ("raise RuntimeError('licence expired')\n", "cannot be imported: RuntimeError: licence expired"),
        ("class AcmeProbe:\n    def connect(self): ...\n", "lacks describe, stop, close, read, __enter__, __exit__"),
    ],
)
def test_one_that_cannot_be_used_says_why_and_spoils_no_other(tmp_path, source, words):
    site = install(tmp_path)
    (site / "acme_probe" / "__init__.py").write_text(source)
    drivers = listed(site)
    assert words in drivers["sensors", "acme_probe"]["problem"]
    assert drivers["sensors", "serial"]["problem"] == ""


def test_two_packages_with_one_name_are_refused_not_mixed_up(tmp_path, monkeypatch):
    site = install(tmp_path)
    other = site / "other_probe-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other-probe\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[mbcacq.sensors]\nacme_probe = other_probe:Probe\n")
    assert "2 packages register this name" in listed(site)["sensors", "acme_probe"]["problem"]
    monkeypatch.syspath_prepend(str(site))
    from mbcacq.devices import load_driver

    with pytest.raises(ConfigError, match="registered 2 times.*acme_probe:AcmeProbe, other_probe:Probe"):
        load_driver("sensors", "acme_probe")


def plan_with_probe(folder, address):
    def change(plan):
        few_views(plan)
        plan["sensors"] = [{"driver": "acme_probe", "model": "T-1000", "options": {"address": address[0], "port": address[1]}}]

    return plan_file(folder, change)


def test_a_run_records_what_it_reads(outside, tmp_path):
    from acme_probe.fake import FakeProbe

    with FakeProbe() as probe:
        plan = plan_with_probe(tmp_path, probe.address)
        hurried = tmp_path / "hurried.yaml"  # no controller is there for the doctor to wait for
        hurried.write_text(plan.read_text().replace("bind: 127.0.0.1", "bind: 127.0.0.1\n    connect_timeout_s: 1.0"))
        assert "connect_timeout_s" in hurried.read_text()
        looked = CliRunner().invoke(app, ["doctor", str(hurried), "--json"])
        lines = {line["topic"]: line for line in json.loads(looked.stdout)["lines"]}
        assert lines["sensor 1"]["level"] == "ok"
        assert lines["sensor 1"]["text"] == "T-1000 0815: air_C 21 C"
        run = tmp_path / "run"
        done = CliRunner().invoke(app, ["run", str(plan), "--dry-run", "--out", str(run)])
        assert done.exit_code == 0, done.stderr
        answers = probe.answers[1:]
    from mbcacq.recording import load_observations

    assert load_observations(run).temperatures["air_C"].tolist() == answers
    assert len(answers) == 4


@pytest.mark.parametrize("each", CHECKS, ids=lambda each: each.__name__)
def test_it_passes_the_suite_every_driver_must_pass(outside, each):
    from acme_probe.conformance import BENCH

    result = check(BENCH, each)
    assert result.status in ("passed", "skipped"), str(result)


def test_the_page_about_it_shows_exactly_this_package():
    page = (ROOT / "docs" / "write-a-driver.md").read_text()
    blocks = re.findall(r"^```(?:python|toml)\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    for name in ("pyproject.toml", "acme_probe/__init__.py", "acme_probe/fake.py", "acme_probe/conformance.py"):
        assert (PACKAGE / name).read_text() in blocks, f"docs/write-a-driver.md does not show {name} as it is"
