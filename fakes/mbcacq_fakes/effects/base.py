"""What all injected effects share: strength, seed, options, and how they count poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq_fakes.world.arm import TrueArm
from mbcacq_fakes.world.description import CellFacts
from mbcacq_fakes.world.hooks import Moments, NoEffect


class InjectedEffect(NoEffect):
    """Subclasses choose their parameters in ``draw`` and act in ``displace`` or ``warp``. options: known names and their defaults."""

    options: Mapping[str, Any] = {}

    def __init__(self, name: str, strength: float, seed: int | None, given: Mapping[str, Any]) -> None:
        unknown = set(given) - set(self.options)
        if unknown:
            known = ", ".join(self.options) or "none besides strength and seed"
            raise ConfigError(f"fake.hidden: {name} knows no option '{min(unknown)}' (known: {known}); correct the plan")
        self.name, self.strength, self._seed = name, float(strength), seed
        self.given = {**self.options, **given}
        self._arrival, self._pose = -1, -1

    def begin(self, cell: CellFacts, arm: TrueArm, rng: np.random.Generator) -> None:
        super().begin(cell, arm, rng if self._seed is None else np.random.default_rng(self._seed))
        self._drawn = self.draw()

    def draw(self) -> dict[str, Any]:
        """Choose the parameters, once. Returns them as ``truth`` names them."""
        raise NotImplementedError

    def truth(self) -> dict[str, Any]:
        return self._drawn

    def axes(self, likely: Sequence[int], most: int = 1) -> list[int]:
        """Indices of the joints concerned: option ``where`` ('A2' or a list), else a draw of up to ``most`` of ``likely``."""
        where = self.given.get("where")
        if where is not None:
            names = [where] if isinstance(where, str) else list(where)
            return [self._axis(str(name)) for name in names]
        possible = [i for i in likely if i < self.cell.n]
        return sorted(self.rng.choice(possible, int(self.rng.integers(1, most + 1)), replace=False).tolist())

    def _axis(self, name: str) -> int:
        known = {wanted: i for i, axis in enumerate(self.cell.axes) for wanted in (axis, f"link{axis.removeprefix('A')}")}
        if name not in known:
            raise ConfigError(f"fake.hidden: {self.name} cannot act at '{name}'; name an axis, {', '.join(self.cell.axes)}")
        return known[name]

    def names(self, axes: Sequence[int], prefix: str = "A") -> list[str]:
        """What the tool calls the axes; with another prefix, their links or angles."""
        return [self.cell.axes[i] if prefix == "A" else f"{prefix}{self.cell.axes[i].removeprefix('A')}" for i in axes]

    def size(self, typical: float, spread: float = 0.3) -> float:
        """A drawn size with a random sign: strength times typical, give or take."""
        return float(self.strength * typical * self.rng.choice([-1, 1]) * self.rng.uniform(1 - spread, 1 + spread))

    def vector(self, length: float, dimension: int = 3) -> np.ndarray:
        """A vector of strength times length in a random direction."""
        direction = self.rng.standard_normal(dimension)
        return self.strength * length * direction / np.linalg.norm(direction)

    @property
    def planned(self) -> np.ndarray:
        """(P, n) rad: the planned poses, or where none are planned some of usual angles."""
        planned = self.cell.planned_q
        return np.random.default_rng(0).uniform(-1.2, 1.2, (200, self.cell.n)) if planned is None or len(planned) < 2 else planned

    def pose_number(self, at: Moments) -> np.ndarray:
        """(P,) how many poses were exposed before; several exposures at one standstill count once."""
        out = np.empty(len(at), dtype=int)
        for k, arrival in enumerate(at.arrival):
            if arrival != self._arrival:
                self._arrival, self._pose = int(arrival), self._pose + 1
            out[k] = self._pose
        return out

    def moment_in_run(self) -> int:
        """A pose number in the middle of the run, or option ``at_pose``."""
        if self.given.get("at_pose") is not None:
            return int(self.given["at_pose"])
        return int(self.rng.uniform(0.3, 0.7) * self.cell.planned_poses)
