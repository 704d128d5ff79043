"""Makes docs/concealed.svg anew: the bar before calibration, after geometry alone, and with the effects that the diagnosis names.

``python docs/_make/concealed_picture.py`` from the root of the checkout; two minutes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from mbcacq.report.charts.spacing_svg import stages_picture

ROOT = Path(__file__).resolve().parents[2]
MBCACQ = str(Path(sys.executable).parent / "mbcacq")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "concealed"

        def call(*command: object) -> None:
            subprocess.run([MBCACQ, *map(str, command)], check=True)

        def places(result: Path) -> list[dict[str, float]]:
            return json.loads(result.read_bytes())["verification"]["places"]

        call("run", ROOT / "plans" / "concealed.yaml", "--dry-run", "--out", run)
        call("diagnose", run, "--calibrate")
        with_effects = places(run / "with-effects" / "result.json")
        call("calibrate", run, "--geometry-alone", "--out", run / "result.json")
        geometry = places(run / "result.json")
    stages = {
        "before": [place["before_mm"] for place in geometry],
        "geometry alone": [place["after_mm"] for place in geometry],
        "effects named": [place["after_mm"] for place in with_effects],
    }
    for name, errors in stages.items():
        print(f"{name}: {np.abs(errors).mean():.3f} mm")
    expected = np.sqrt(2 / np.pi) * np.mean([place["expected_mm"] for place in with_effects])
    names = [str(place["station"]) for place in geometry]
    picture = stages_picture(names, {name: np.array(errors) for name, errors in stages.items()}, float(expected))
    (ROOT / "docs" / "concealed.svg").write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    main()
