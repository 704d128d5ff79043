"""Makes the pictures of viewer and report anew: a dry run, its diagnosis, screenshots without a screen.

``python docs/_make/pictures.py`` from the root of the checkout; some minutes. Needs a Vulkan driver and Chromium (Debian's packages
mesa-vulkan-drivers and chromium).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
MBCACQ = str(Path(sys.executable).parent / "mbcacq")
CHROMIUM = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
            "--disable-component-update", "--hide-scrollbars", "--window-size=1280,860")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        call(MBCACQ, "run", ROOT / "plans" / "kuka.yaml", "--dry-run", "--out", work / "kuka")
        shutil.copy(tab(work / "kuka", work / "tabs", "cell", pose=40), DOCS / "run.png")
        page = (work / "kuka" / "report.html").as_uri()
        call("chromium", *CHROMIUM, f"--user-data-dir={work / 'browser'}", f"--screenshot={DOCS / 'report.png'}", page)
        call(MBCACQ, "run", ROOT / "plans" / "kuka-effects.yaml", "--dry-run", "--out", work / "effects")
        call(MBCACQ, "diagnose", work / "effects")
        shutil.copy(tab(work / "effects", work / "more-tabs", "diagnosis", pose=40), DOCS / "view-diagnosis.png")


def tab(run: Path, into: Path, name: str, pose: int) -> Path:
    """The picture of one tab of the viewer."""
    into.mkdir()
    call(MBCACQ, "view", run, "--screenshot", into, "--pose", pose)
    return next(p for p in sorted(into.glob("*.png")) if name in p.name.lower())


def call(*command) -> None:
    subprocess.run([str(part) for part in command], check=True)


if __name__ == "__main__":
    main()
