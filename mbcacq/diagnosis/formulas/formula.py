"""A formula: terms at a location, as an effect like any other of the catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.formulas.dictionary import DictionaryEntry
from mbcacq.diagnosis.nonparametric.locations import Location
from mbcacq.effects.context import Context
from mbcacq.effects.described import built
from mbcacq.effects.effect import Candidate
from mbcacq.effects.functions import ZERO, Column, DescribedPart, scaled

NAME = "formula"
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class PlacedTerm:
    """A term that moves some components of a location: rows of its ``mix``."""

    location: Location
    rows: tuple[int, ...]
    term: DictionaryEntry

    @property
    def label(self) -> str:
        return f"{self.location.name}{self.rows}:{self.term.label}"

    @property
    def rotates(self) -> np.ndarray:
        """(k,) bool of the coefficients that are rotations."""
        return np.repeat([self.is_rotation(row) for row in self.rows], len(self.term.columns))

    def is_rotation(self, row: int) -> bool:
        """Whether a row of the mix is a rotation."""
        keys = [key for key, share in zip(self.location.keys, self.location.mix[row], strict=True) if share]
        return keys[0][0] == "joint" or (keys[0][0] == "frame" and keys[0][2] >= 3)

    def component(self, row: int) -> str:
        """What a row of the mix is called, e.g. 'A2' or 'rx'."""
        place = self.location.keys[0][0]
        return self.location.name if place == "joint" else COMPONENTS[row]

    @property
    def coefficients(self) -> list[tuple[str, str]]:
        """(component, text of the column) of each coefficient."""
        return [(self.component(row), text) for row in self.rows for text in self.term.texts]


def described(placed: Sequence[PlacedTerm]) -> list[DescribedPart]:
    """The parts that all terms displace together; coefficients are ordered term by term, and in each component by component."""
    count = sum(len(p.rows) * len(p.term.columns) for p in placed)
    columns: dict[tuple[str, int, int], list[Column]] = {}
    start = 0
    for one in placed:
        for row in one.rows:
            for key, share in zip(one.location.keys, one.location.mix[row], strict=True):
                if abs(share) > 1e-12:
                    own = columns.setdefault(key, [ZERO] * count)
                    for j, column in enumerate(one.term.columns):
                        own[start + j] = scaled(column, float(share)) if share != 1.0 else column
            start += len(one.term.columns)
    return [DescribedPart(*key, tuple(own)) for key, own in columns.items()]


def candidate(context: Context, placed: Sequence[PlacedTerm], typical: np.ndarray) -> Candidate:
    """The terms as one effect, whose coefficients have these typical sizes (k,)."""
    parts = described(placed)
    first = placed[0]
    where, on = (first.location.name,), first.term.covariates[0]
    return Candidate(
        NAME,
        where,
        on,
        built(context, parts),
        lambda c, v, h: {},
        typical,
        several=True,
        variant=" + ".join(p.label for p in placed),
        described=lambda _: parts,
    )
