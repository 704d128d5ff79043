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

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
MBCACQ = str(Path(sys.executable).parent / "mbcacq")
CHROMIUM = (
    "chromium",
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--hide-scrollbars",
    "--window-size=1280,860",
)
ELASTIC = """
fake:
  hidden:
    - {name: joint_compliance, where: A2, compliance_rad_per_Nm: 2.1e-6}
    - {name: joint_compliance, where: A3, compliance_rad_per_Nm: 1.9e-6}
"""
MENU_PX = 36  # height of the viewer's menu, which tells of the machine that drew the picture


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        shutil.copytree(ROOT / "plans", work / "plans")

        def call(*command: object) -> None:
            subprocess.run([str(part) for part in command], check=True, cwd=work)  # pages show paths as a user has them, not this folder

        def tab(run: str, name: str, pose: int, picture: str) -> None:
            """One tab of the viewer as a picture of the documentation."""
            call(MBCACQ, "view", run, "--screenshot", f"tabs-{name}", "--pose", pose)
            with Image.open(next((work / f"tabs-{name}").glob(f"*{name}*.png"))) as image:
                image.crop((0, MENU_PX, *image.size)).save(DOCS / picture, optimize=True)

        call(MBCACQ, "run", "plans/kuka.yaml", "--dry-run", "--out", "runs/kuka")
        tab("runs/kuka", "cell", 40, "run.png")
        page = (work / "runs" / "kuka" / "report.html").as_uri()
        call(*CHROMIUM, f"--user-data-dir={work / 'browser'}", f"--screenshot={DOCS / 'report.png'}", page)
        plan = work / "plans" / "elastic.yaml"
        plan.write_text((work / "plans" / "kuka-effects.yaml").read_text(encoding="utf-8") + ELASTIC, encoding="utf-8")
        call(MBCACQ, "run", "plans/elastic.yaml", "--dry-run", "--out", "runs/elastic")
        call(MBCACQ, "diagnose", "runs/elastic")
        tab("runs/elastic", "diagnosis", 60, "view-diagnosis.png")


if __name__ == "__main__":
    main()
