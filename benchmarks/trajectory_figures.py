"""The pictures of docs/data/kr300.md: residuals before and after, of each trajectory as predicted by the other one.

python benchmarks/trajectory_figures.py ../shared/data/kr300-trajectory-a ../shared/data/kr300-trajectory-b --out docs/data
"""

from __future__ import annotations

import argparse
from html import escape
from pathlib import Path

import numpy as np

from mbcacq.diagnosis.motion.diagnose import explain_trajectories
from mbcacq.recording import read_trajectory_set

WIDTH, HEIGHT, LEFT, TOP = 430, 110, 56, 34
GREY, BLUE = "#bbbbbb", "#1f6fb2"
TITLES = {
    "q_joint": "Joint-side minus motor-side angle, mdeg",
    "q_set": "Actual angle minus set point, deg",
    "tau": "Torque minus rigid arm, N m",
}


def figure(kind: str, panels: list[list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]]) -> str:
    """panels[row][column] = (name, time (T,), before (T,), after (T,))."""
    rows, columns = len(panels), len(panels[0])
    out = [_text(10, 18, f"{TITLES[kind]}; grey: before, blue: what the other trajectory leaves unexplained", 13)]
    for i, row in enumerate(panels):
        for j, (name, time, before, after) in enumerate(row):
            x, y = LEFT + j * (WIDTH + LEFT), TOP + i * (HEIGHT + 22)
            top = max(float(np.abs(before).max()), 1e-12)
            out.append(_text(x, y + 10, name, 11))
            out.append(_text(x - 4, y + 10, f"{top:.3g}", 10, "end"))
            out.append(f'<line x1="{x}" y1="{y + HEIGHT / 2}" x2="{x + WIDTH}" y2="{y + HEIGHT / 2}" stroke="#dddddd"/>')
            for values, colour in ((before, GREY), (after, BLUE)):
                points = " ".join(
                    f"{x + WIDTH * (t - time[0]) / (time[-1] - time[0]):.1f},{y + HEIGHT / 2 * (1 - v / top):.1f}"
                    for t, v in zip(time[::6], np.clip(values[::6], -top, top), strict=True)
                )
                out.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1"/>')
    width, height = LEFT + columns * (WIDTH + LEFT), TOP + rows * (HEIGHT + 22) + 8
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif">'
        f'<rect width="{width}" height="{height}" fill="white"/>{"".join(out)}</svg>\n'
    )


def _text(x: float, y: float, words: str, size: int, anchor: str = "start") -> str:
    return f'<text x="{x}" y="{y}" font-size="{size}" text-anchor="{anchor}">{escape(words)}</text>'


def panels(folders: list[Path]) -> dict[str, list[list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]]]:
    trajectories = [read_trajectory_set(f) for f in folders]
    out: dict[str, list] = {}
    for held in range(len(trajectories)):
        for e in explain_trajectories(trajectories, held):
            scale = {"q_joint": 1e3 * np.degrees(1), "q_set": np.degrees(1)}.get(e.group.name, 1.0)
            rows = out.setdefault(e.group.name, [[] for _ in e.group.joints])
            for k, joint in enumerate(e.group.joints):
                used = e.used[k][held]
                before, after = (scale * residual[k][held][used] for residual in (e.residual_before, e.residual_after))
                if e.group.refit:
                    before, after = before - before.mean(), after - after.mean()
                time = trajectories[held].time_s[used]
                rows[k].append((f"A{joint + 1}, {folders[held].name}: {before.std():.3g} -> {after.std():.3g} rms", time, before, after))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    for kind, rows in panels(given.folders).items():
        (given.out / f"kr300-{kind}.svg").write_text(figure(kind, rows), encoding="utf-8")


if __name__ == "__main__":
    main()
