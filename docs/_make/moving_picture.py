"""Draws the moving picture of the README from a recording: the arm measures, balls are found, the error shrinks, effects are named.

``python docs/_make/moving_picture.py RUN docs/run.webp`` for the folder of a run that was diagnosed (``mbcacq diagnose RUN --calibrate``);
that of the README is ``plans/concealed.yaml``, dry.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mbcacq.diagnosis.result import Diagnosis
from mbcacq.recording import load_observations
from mbcacq.recording.rrd.reader import open_recordings
from mbcacq.report.sources.from_diagnosis import diagnosis_content

SIZE, FRAME_MS = (880, 460), 200
MEASURING_S, SHRINKING_S, NAMING_S = 11.0, 4.0, 5.0  # 20 s altogether
BEFORE_S = 1.2  # for which the errors stand as they were before they shrink
NIGHT, INK, SOFT, ARM = (18, 21, 27), (236, 239, 243), (140, 148, 160), (240, 106, 22)
BEFORE, AFTER, LIMIT, BALL = (230, 159, 0), (86, 180, 233), (235, 96, 60), (0, 190, 140)
CELL, SCAN, BARS = (10, 40, 520, 450), (540, 40, 870, 230), (540, 255, 870, 450)


@dataclass(frozen=True)
class Film:
    """What is drawn. joints: (P, n + 1, 3) mm, base and joints of each pose; balls: for each pose (k, 3) mm in the base; scans: points
    (m, 3) mm of the scanner frame by pose number; numbers: (P,) of the poses; errors: (k,) mm length errors before calibration, after it,
    and with the effects that were found, where there are such; limit: mm or None."""

    joints: np.ndarray
    balls: list[np.ndarray]
    scans: dict[int, np.ndarray]
    found: list[np.ndarray]
    numbers: np.ndarray
    errors: list[np.ndarray]
    limit: float | None
    sentences: list[str]


def film_of(run: Path) -> Film:
    observations = load_observations(run)
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    frames = observations.cell.robot.chain.frames(observations.q)
    joints = np.concatenate([np.zeros((len(frames), 1, 3)), frames[:, :, :3, 3]], axis=1)
    T = frames[:, -1] @ observations.cell.T_flange_scanner
    found = [observations.xyz[observations.pose == k] for k in range(observations.n_poses)]
    balls = [xyz @ T[k, :3, :3].T + T[k, :3, 3] for k, xyz in enumerate(found)]
    places = (result.get("verification") or {}).get("places", [])
    errors = [np.array([p[key] for p in places]) for key in ("before_mm", "after_mm")]
    corrected = run / "with-effects" / "result.json"
    if corrected.exists():
        with_effects = json.loads(corrected.read_text(encoding="utf-8"))["verification"]["places"]
        errors.append(np.array([p["after_mm"] for p in with_effects]))
    limit = (result.get("verification") or {}).get("limit_mm")
    return Film(joints, balls, scans_of(run), found, observations.pose_id, errors, limit, sentences_of(run))


def scans_of(run: Path, most: int = 1500) -> dict[int, np.ndarray]:
    """The last scan of every second pose, thinned."""
    out: dict[int, np.ndarray] = {}
    for recording in open_recordings(run):
        for one in recording.scans():
            if one.pose % 2 == 0:
                points = np.asarray(one.scan.points, dtype=float)
                out[one.pose] = points[:: max(len(points) // most, 1)]
    return out


def sentences_of(run: Path) -> list[str]:
    """The diagnosis in a few lines; none where the run was not diagnosed."""
    try:
        content = diagnosis_content(Diagnosis.from_json(json.loads((run / "diagnosis.json").read_text(encoding="utf-8"))), None)
    except OSError:
        return []
    if not content.effects:
        return [content.headline]
    lines = []
    for effect in content.effects:
        lines.append(effect.title)
        certain = [p for p in effect.parameters if abs(float(p[1])) > 2 * float(p[2]) and not p[0].endswith(("order", "phase"))]
        lines += [f"   {name} {value} ± {uncertainty} {unit}" for name, value, uncertainty, unit in certain]
    return lines


@cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """Matplotlib's, which has µ and every other sign of a unit."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", size)


class Frame:
    """One picture of the film."""

    def __init__(self, film: Film, seconds: float) -> None:
        self.film, self.seconds = film, seconds
        self.image = Image.new("RGB", SIZE, NIGHT)
        self.draw = ImageDraw.Draw(self.image)
        share = min(seconds / MEASURING_S, 1.0)
        self.at = share * (len(film.numbers) - 1)
        self.pose = int(self.at)

    def drawn(self) -> Image.Image:
        self._cell()
        self._scan()
        self._bars()
        step = "measure" if self.seconds < MEASURING_S else "calibrate" if self.seconds < MEASURING_S + SHRINKING_S else "diagnose"
        for k, name in enumerate(("measure", "calibrate", "diagnose")):
            self._text((12 + 130 * k, 8), name, 20, INK if name == step else SOFT)
        if step == "measure":
            self._text((540, 10), f"pose {self.pose + 1} of {len(self.film.numbers)}", 16, SOFT)
        return self.image

    def _cell(self) -> None:
        """Arm and measured balls, looked at from a point that moves slowly round the cell."""
        turn = -0.9 + 0.025 * self.seconds
        low, high = self.film.joints.reshape(-1, 3).min(axis=0), self.film.joints.reshape(-1, 3).max(axis=0)
        middle, unit = (low + high) / 2, 430.0 / float(np.linalg.norm(high - low))

        def place(points: np.ndarray) -> list[tuple[float, float]]:
            x, y, z = (points - middle).T
            right, away = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
            return [(260 + 1.25 * unit * r, 245 - 1.25 * unit * (0.9 * h + 0.43 * a)) for r, h, a in zip(right, z, away, strict=True)]

        for centres in self.film.balls[: self.pose + 1]:
            for x, y in place(centres) if len(centres) else ():
                self.draw.ellipse((x - 2, y - 2, x + 2, y + 2), fill=BALL)
        following = min(self.pose + 1, len(self.film.joints) - 1)
        weight = self.at - self.pose
        arm = place((1 - weight) * self.film.joints[self.pose] + weight * self.film.joints[following])
        self.draw.line(arm, fill=ARM, width=12, joint="curve")
        for x, y in arm[1:]:
            self.draw.ellipse((x - 7, y - 7, x + 7, y + 7), fill=(52, 56, 64))

    def _scan(self) -> None:
        """The latest scan from above, and a circle round each ball that was found in it; in the end what the diagnosis says."""
        if self.seconds >= MEASURING_S + SHRINKING_S and self.film.sentences:
            for k, line in enumerate(self.film.sentences[:8]):
                self._text((540, 40 + 24 * k), line, 13 if line.startswith(" ") else 15, INK if line.startswith(" ") else AFTER)
            return
        number = max((n for n in self.film.scans if n <= self.film.numbers[self.pose]), default=None)
        self.draw.rectangle(SCAN, outline=(58, 64, 76))
        if number is None:
            return
        points = self.film.scans[number]
        centre, unit = (705.0, 135.0), 180.0 / 150.0
        for x, y, z in points:
            shade = int(np.clip(150 + 2 * z, 70, 235))
            self.draw.point((centre[0] + unit * y, centre[1] + unit * x), fill=(shade, shade, shade))
        pose = int(np.flatnonzero(self.film.numbers == number)[0]) if number in self.film.numbers else self.pose
        for x, y, _ in self.film.found[pose]:
            u, v = centre[0] + unit * y, centre[1] + unit * x
            self.draw.ellipse((u - 10, v - 10, u + 10, v + 10), outline=BALL, width=2)
        self._text((548, 206), f"{(count := len(self.film.found[pose]))} ball{'' if count == 1 else 's'} found", 16, BALL)

    def _bars(self) -> None:
        """Length errors, which are known after the bar was measured, shrink while the cell is calibrated, and become those of the cell with
        its effects when these are named."""
        if self.seconds < MEASURING_S or not len(self.film.errors[0]):
            return
        stage = 0 if self.seconds < MEASURING_S + SHRINKING_S or len(self.film.errors) < 3 else 1
        began = MEASURING_S + BEFORE_S + stage * SHRINKING_S
        share = float(np.clip((self.seconds - began) / (SHRINKING_S - 2 * BEFORE_S), 0.0, 1.0))
        share = share * share * (3 - 2 * share)
        start, end = (np.abs(self.film.errors[stage + k]) for k in (0, 1))
        values = (1 - share) * start + share * end
        top = 1.05 * float(np.abs(self.film.errors[0]).max())
        left, head, right, bottom = BARS[0], BARS[1] + 26, BARS[2], BARS[3] - 6
        width = (right - left) / len(values)
        colours = (BEFORE, AFTER, BALL)[stage : stage + 2]
        self._text((left, BARS[1]), f"length error, largest {values.max():.3f} mm", 14, colours[share > 0.5])
        colour = tuple(int((1 - share) * b + share * a) for b, a in zip(*colours, strict=True))
        for k, value in enumerate(values):
            x, y = left + width * k, bottom - (bottom - head) * value / top
            self.draw.rectangle((x + 3, min(y, bottom - 1), x + width - 3, bottom), fill=colour)
        if self.film.limit is not None:
            y = bottom - (bottom - head) * self.film.limit / top
            self.draw.line((left, y, right, y), fill=LIMIT, width=2)
            self._text((right - 88, BARS[1] + 3), f"limit {self.film.limit:g} mm", 12, LIMIT)

    def _text(self, at: tuple[float, float], text: str, size: int, colour: tuple[int, int, int]) -> None:
        self.draw.text(at, text, font=font(size), fill=colour)


def main() -> None:
    run, picture = Path(sys.argv[1]), Path(sys.argv[2])
    film = film_of(run)
    seconds = np.arange(0.0, MEASURING_S + SHRINKING_S + NAMING_S, FRAME_MS / 1000)
    first, *others = [Frame(film, float(s)).drawn() for s in seconds]
    first.save(picture, save_all=True, append_images=others, duration=FRAME_MS, loop=0, quality=50, method=2)
    print(f"{picture}: {len(others) + 1} frames, {picture.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
