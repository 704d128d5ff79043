"""One challenge from its envelope to its score, and many of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from mbcacq.challenge import oracle, simulated_cells
from mbcacq.challenge.scenarios import OUTSIDE, Scenario
from mbcacq.challenge.score import Score, score
from mbcacq.challenge.strength import Gauge
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.plan import LoadedPlan, PlannedPose, expand, load


@dataclass(frozen=True)
class Outcome:
    """envelope as drawn, what was concealed as the fake cell was told, the truth it told afterwards, the diagnosis and its score."""

    envelope: Scenario
    concealed: list[dict[str, Any]]
    truth: list[dict[str, Any]]
    diagnosis: dict[str, Any]
    score: Score
    seconds: float

    def to_dict(self, full: bool = False) -> dict[str, Any]:
        out = {"envelope": self.envelope.to_dict(), "concealed": self.concealed, "score": self.score.to_dict(), "diagnosis_s": self.seconds}
        return out | ({"truth": self.truth, "diagnosis": self.diagnosis} if full else {})


@dataclass(frozen=True)
class Challenger:
    """Everything that one plan's challenges share. folder: where recordings and opened envelopes are kept, None for nowhere."""

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]
    gauge: Gauge
    protocols: bool = False
    folder: Path | None = None

    @classmethod
    def of(cls, plan: Path, protocols: bool = False, folder: Path | None = None) -> Challenger:
        """Raises ConfigError where the plan is wrong."""
        loaded = load(plan)
        poses = expand(loaded)
        return cls(loaded, poses, Gauge(loaded, poses), protocols, folder)

    def take(self, envelope: Scenario) -> Outcome:
        """Conceal, record, diagnose without looking, open, score."""
        concealed = self.gauge.conceal(envelope)
        observations, told = self._record(envelope, concealed)
        start = perf_counter()
        diagnosis = diagnose(observations).to_json()
        seconds = perf_counter() - start
        truth = [with_places(plain(effect)) for effect in told["effects"]]
        outside = any(name in OUTSIDE for name in envelope.names)
        if outside:
            clean, _ = simulated_cells.observe(self.loaded, self.poses, envelope, [])
            fast = observations if not self.protocols else simulated_cells.observe(self.loaded, self.poses, envelope, concealed)[0]
            possible = oracle.without_effect(fast, clean)
        else:
            possible = oracle.achievable(observations, truth)
            truth = [{**t, **({"adds": possible.adds[j]} if possible.adds else {})} for j, t in enumerate(truth)]
        result = score(envelope.kind, truth, diagnosis, possible.improvement if truth else 0.0, catalogued=not outside)
        outcome = Outcome(envelope, concealed, truth, diagnosis, result, seconds)
        if self.folder is not None:
            self._keep(outcome, observations)
        return outcome

    def _record(self, envelope: Scenario, concealed: list[dict[str, Any]]):
        if not self.protocols:
            return simulated_cells.observe(self.loaded, self.poses, envelope, concealed)
        if self.folder is not None:
            return simulated_cells.run(self.loaded, self.poses, envelope, concealed, self.folder / f"{envelope.number:03d}" / "run")
        with TemporaryDirectory(prefix="mbcacq-challenge-") as temporary:
            return simulated_cells.run(self.loaded, self.poses, envelope, concealed, Path(temporary))

    def _keep(self, outcome: Outcome, observations) -> None:
        from mbcacq.recording import write_observation_set

        place = self.folder / f"{outcome.envelope.number:03d}"
        place.mkdir(parents=True, exist_ok=True)
        if not self.protocols:
            write_observation_set(observations, place / "observations")
        (place / "diagnosis.json").write_text(json.dumps(outcome.diagnosis, indent=1), encoding="utf-8")
        (place / "envelope.json").write_text(json.dumps(outcome.to_dict(full=True), indent=1), encoding="utf-8")


def with_places(effect: dict[str, Any]) -> dict[str, Any]:
    """A wrong tool moves the elastic joints: that is where it is first seen."""
    if effect["name"] != "payload":
        return effect
    return {**effect, "seen_at": [f"A{i + 1}" for i, c in enumerate(effect["compliance_rad_per_Nm"]) if c > 0]}


def plain(value: Any) -> Any:
    """Arrays as lists, so that an envelope can be written down."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value.tolist() if hasattr(value, "tolist") else value


_challenger: Challenger | None = None


def _begin(plan: Path, protocols: bool, folder: Path | None) -> None:
    global _challenger
    _challenger = Challenger.of(plan, protocols, folder)


def _take(envelope: Scenario) -> Outcome:
    assert _challenger is not None
    return _challenger.take(envelope)


def take_all(
    plan: Path,
    envelopes: Sequence[Scenario],
    protocols: bool = False,
    folder: Path | None = None,
    jobs: int = 1,
    progress: Callable[[Outcome], None] = lambda outcome: None,
) -> list[Outcome]:
    """All challenges, in the order of their envelopes; in ``jobs`` processes. Raises what stopped one."""
    out = []
    for outcome in _each(plan, envelopes, protocols, folder, jobs):
        progress(outcome)
        out.append(outcome)
    return out


def _each(plan: Path, envelopes: Sequence[Scenario], protocols: bool, folder: Path | None, jobs: int) -> Iterator[Outcome]:
    if jobs == 1:
        challenger = Challenger.of(plan, protocols, folder)
        yield from map(challenger.take, envelopes)
        return
    with ProcessPoolExecutor(jobs, initializer=_begin, initargs=(plan, protocols, folder)) as pool:
        yield from pool.map(_take, envelopes)
