"""Rules of the repository that a reader cannot see at a glance."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = ("open3d", "rerun", "scipy", "plotly", "pyarrow", "numpy", "pydantic")


def test_import_contracts_are_kept():
    done = subprocess.run([Path(sys.executable).parent / "lint-imports"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_help_imports_nothing_heavy():
    code = "import sys; sys.argv = ['mbcacq', '--help']\nfrom mbcacq.cli import main\ntry: main()\nexcept SystemExit: pass\nprint(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
    assert not {m for m in out[-1].split() if m.split(".")[0] in HEAVY}
    assert any("execute a plan" in line for line in out)


def test_every_command_is_there_and_has_help():
    from mbcacq.cli.app import COMMANDS, app

    table = [line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("| `mbcacq ")]
    for name in COMMANDS:
        command = app.get_command(None, name)
        assert command is not None, name
        assert command.help, name
        assert any(re.search(rf"`mbcacq {name}\b", line) for line in table), f"README.md has no row for mbcacq {name}: say what it does"


def test_ci_runs_what_the_readme_says():
    readme, ci = (ROOT / "README.md").read_text(), (ROOT / ".ci" / "run").read_text()
    command = next(line for line in readme.splitlines() if "pytest" in line)
    for part in command.split(" && "):
        assert part in ci


def test_no_two_files_of_the_tests_have_one_name():
    """They stand in no packages: if two have one name, the one imported first is taken for the other, and the suite does not begin."""
    names = [path.name for path in (ROOT / "tests").rglob("*.py") if path.name != "conftest.py"]
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize("name", ["README.md", "docs/index.md"])
def test_links_lead_somewhere(name):
    import re

    page = ROOT / name
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{name}: {target}"
