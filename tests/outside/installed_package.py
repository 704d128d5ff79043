"""The example package, installed as pip would: its modules and its metadata in a folder on the path, nothing of ours changed."""

import shutil
import tomllib
from pathlib import Path

PACKAGE = Path(__file__).with_name("acme_probe_package")


def install(site, package=PACKAGE):
    """Copy the modules and write the .dist-info that a wheel of this pyproject.toml would have."""
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    for module in package.iterdir():
        if module.is_dir():
            shutil.copytree(module, site / module.name, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = project["entry-points"]
    (info / "entry_points.txt").write_text(
        "".join(f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in points.items()) for group, points in groups.items())
    )
    return site
