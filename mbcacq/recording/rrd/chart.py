"""A chart in a 2D view of the viewer, for what is no curve over time: bars with whiskers, points over a variable, limit lines.

Drawn in points of a sheet of SHEET, x to the right and y downwards, as the viewer's 2D views count them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

SHEET = (900.0, 420.0)  # width and height of a chart with its labels
LEFT, RIGHT, TOP, BOTTOM = 70.0, 20.0, 62.0, 62.0
INK, GRID, LIMIT = (190, 198, 210), (58, 64, 76), (235, 96, 60)
Colour = tuple[int, ...]


def round_step(span: float, most: int) -> float:
    """The smallest of 1, 2, 5 times a power of ten that divides ``span`` (above zero) into at most ``most`` parts."""
    power = 10.0 ** np.floor(np.log10(span / most))
    return float(next(f * power for f in (1.0, 2.0, 5.0, 10.0) if span / (f * power) <= most + 1e-9))


class Chart:
    """Axes with ticks and labels on ``entity``; what is drawn into them stands below it, static."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        entity: str,
        x: tuple[float, float],
        y: tuple[float, float],
        labels: tuple[str, str],
        names: Sequence[str] | None = None,
    ) -> None:
        """x, y: ranges of the axes; labels: of the x and the y axis; names: of the places 0, 1, .. on the x axis instead of numbers."""
        self._rec, self._entity, self._x, self._y, self._keys = stream, entity, x, y, 0
        self._axes(labels, names)

    def at(self, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        """(k, 2) points of the sheet of values in the axes; what lies outside stands at the edge."""
        (x0, x1), (y0, y1) = self._x, self._y
        column = LEFT + (np.clip(np.asarray(x, float), x0, x1) - x0) / (x1 - x0) * (SHEET[0] - LEFT - RIGHT)
        row = SHEET[1] - BOTTOM - (np.clip(np.asarray(y, float), y0, y1) - y0) / (y1 - y0) * (SHEET[1] - TOP - BOTTOM)
        return np.stack(np.broadcast_arrays(column, row), axis=-1).reshape(-1, 2)

    def bars(self, name: str, x: np.ndarray, y: np.ndarray, width: float, colour: Colour) -> None:
        """Bars from zero, ``width`` in units of x, centred on x (k,) with height y (k,)."""
        corner, opposite = self.at(x - width / 2, 0.0), self.at(x + width / 2, y)
        low, high = np.minimum(corner, opposite), np.maximum(corner, opposite)
        lines = [np.array([[c, a], [c, b]]) for (left, a), (right, b) in zip(low, high, strict=True) for c in np.arange(left, right, 0.8)]
        self._strips(name, lines, colour, 0.9)
        self._key(name, colour)

    def whiskers(self, name: str, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: Colour = INK) -> None:
        """Vertical lines from low (k,) to high (k,) with a foot and a head."""
        ends = zip(self.at(x, low), self.at(x, high), strict=True)
        foot = np.array([5.0, 0.0])
        self._strips(name, [line for a, b in ends for line in ([a, b], [a - foot, a + foot], [b - foot, b + foot])], colour, 0.8)
        self._key(name, colour)

    def level(self, name: str, y: Sequence[float], colour: Colour = LIMIT) -> None:
        """Horizontal lines over the whole width, e.g. a limit; without a name they are not in the legend."""
        self._strips(name or "zero", [self.at(np.array(self._x), v) for v in y], colour, 1.0)
        if name:
            self._key(name, colour)

    def points(self, name: str, x: np.ndarray, y: np.ndarray, colour: Colour, radius: float = 2.2) -> None:
        self._rec.log(f"{self._entity}/{_part(name)}", rr.Points2D(self.at(x, y), colors=[colour], radii=radius), static=True)
        self._key(name, colour)

    def line(self, name: str, x: np.ndarray, y: np.ndarray, colour: Colour) -> None:
        self._strips(name, [self.at(x, y)], colour, 1.2)
        self._key(name, colour)

    def _axes(self, labels: tuple[str, str], names: Sequence[str] | None) -> None:
        left, right, top, bottom = LEFT, SHEET[0] - RIGHT, TOP, SHEET[1] - BOTTOM
        frame = np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
        self._rec.log(f"{self._entity}/frame", rr.LineStrips2D([frame], colors=[GRID], radii=0.6), static=True)
        places: list[np.ndarray] = []
        texts: list[str] = []
        grid: list[np.ndarray] = []
        y_step = round_step(self._y[1] - self._y[0], 6)
        for v in np.arange(np.ceil(self._y[0] / y_step), np.floor(self._y[1] / y_step + 1e-9) + 1) * y_step:
            at = self.at(self._x[0], v)[0]
            places.append(at - [34.0, 9.0])
            texts.append(f"{v + 0.0:.6g}")
            grid.append(np.array([at, [right, at[1]]]))
        if names is None:
            x_step = round_step(self._x[1] - self._x[0], 8)
            marks = [
                (v, f"{v + 0.0:.6g}") for v in np.arange(np.ceil(self._x[0] / x_step), np.floor(self._x[1] / x_step + 1e-9) + 1) * x_step
            ]
        else:
            every = len(names) // 16 + 1
            marks = [(float(k), name) for k, name in enumerate(names) if k % every == 0]
        for v, text in marks:
            places.append(self.at(v, self._y[0])[0] + [0.0, 4.0])
            texts.append(text)
        places += [np.array([(left + right) / 2, SHEET[1] - 32.0]), np.array([(left + right) / 2, 2.0])]
        self._rec.log(f"{self._entity}/grid", rr.LineStrips2D(grid, colors=[GRID], radii=0.4), static=True)
        self._labels("ticks", places, [*texts, *labels])

    def _key(self, name: str, colour: Colour) -> None:
        """The entry of the legend, above the chart."""
        at = np.array([170.0 + 150.0 * self._keys, 40.0])
        self._keys += 1
        self._rec.log(f"{self._entity}/key/{_part(name)}", rr.Points2D([at - [62.0, 0.0]], colors=[colour], radii=5.0), static=True)
        self._labels(f"key/{_part(name)}/text", [at - [0.0, 10.0]], [name])

    def _labels(self, part: str, places: Sequence[np.ndarray], texts: Sequence[str]) -> None:
        self._rec.log(
            f"{self._entity}/{part}",
            rr.Points2D(np.array(places), labels=list(texts), show_labels=True, radii=0.01, colors=[INK]),
            static=True,
        )

    def _strips(self, name: str, strips: Sequence[Sequence[np.ndarray] | np.ndarray], colour: Colour, radius: float) -> None:
        self._rec.log(
            f"{self._entity}/{_part(name)}", rr.LineStrips2D([np.array(s) for s in strips], colors=[colour], radii=radius), static=True
        )


def _part(name: str) -> str:
    return rr.escape_entity_path_part(name)
