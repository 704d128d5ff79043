"""One challenge from its scenario to its score, and many of them."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Annotated, Any

from pydantic import Field

from mbcacq.challenge import oracle, simulated_cells
from mbcacq.challenge.scenarios import OUTSIDE, Scenario
from mbcacq.challenge.score import Score, score
from mbcacq.challenge.strength import Gauge
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.effects.catalogue import declaration
from mbcacq.files.atomic_write import write_files
from mbcacq.model.json_text import fields_as_json, plain
from mbcacq.plan import LoadedPlan, PlannedPose, expand, load
from mbcacq.recording.datasets.observation_set import write_observation_set


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """scenario: as drawn. injected: as a plan's ``fake: hidden`` states it. truth: the injected effects with their parameters, as the fake
    cell states them after the recording. diagnosis: as its JSON object.
    """

    scenario: Scenario
    injected: list[dict[str, Any]]
    score: Score
    seconds: Annotated[float, Field(alias="diagnosis_s")]
    truth: list[dict[str, Any]]
    diagnosis: dict[str, Any]

    def to_dict(self, full: bool = False) -> dict[str, Any]:
        """JSON content; full: with truth and diagnosis."""
        return {key: value for key, value in fields_as_json(self).items() if full or key not in ("truth", "diagnosis")}


@dataclass(frozen=True)
class Challenger:
    """Everything that one plan's challenges share. folder: where recordings and scenarios are kept, None for nowhere."""

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]
    gauge: Gauge
    protocols: bool = False
    folder: Path | None = None

    @classmethod
    def of(cls, plan: Path, protocols: bool = False, folder: Path | None = None) -> Challenger:
        """Raises ConfigError if the plan is wrong."""
        loaded = load(plan)
        poses = expand(loaded)
        return cls(loaded, poses, Gauge(loaded, poses), protocols, folder)

    def take(self, scenario: Scenario) -> Outcome:
        """Inject the effects, record, diagnose the recording without knowledge of them, and score."""
        injected = self.gauge.inject(scenario)
        observations, stated = self._record(scenario, injected)
        start = perf_counter()
        diagnosis = diagnose(observations).to_json()
        seconds = perf_counter() - start
        truth = [with_observable_locations(plain(effect)) for effect in stated["effects"]]
        outside = any(name in OUTSIDE for name in scenario.names)
        if outside:
            clean, _ = simulated_cells.observe(self.loaded, self.poses, scenario, [])
            fast = observations if not self.protocols else simulated_cells.observe(self.loaded, self.poses, scenario, injected)[0]
            possible = oracle.without_effect(fast, clean)
        else:
            possible = oracle.achievable(observations, truth)
            truth = [{**t, **({"adds": possible.adds[j]} if possible.adds else {})} for j, t in enumerate(truth)]
        result = score(scenario.kind, truth, diagnosis, possible.improvement if truth else 0.0, catalogued=not outside)
        outcome = Outcome(scenario=scenario, injected=injected, score=result, seconds=seconds, truth=truth, diagnosis=diagnosis)
        if self.folder is not None:
            self._keep(outcome, observations)
        return outcome

    def _record(self, scenario: Scenario, injected: list[dict[str, Any]]):
        if not self.protocols:
            return simulated_cells.observe(self.loaded, self.poses, scenario, injected)
        if self.folder is not None:
            return simulated_cells.run(self.loaded, self.poses, scenario, injected, self.folder / f"{scenario.number:03d}" / "run")
        with TemporaryDirectory(prefix="mbcacq-challenge-") as temporary:
            return simulated_cells.run(self.loaded, self.poses, scenario, injected, Path(temporary))

    def _keep(self, outcome: Outcome, observations) -> None:
        assert self.folder is not None, "only called where a folder is given"
        place = self.folder / f"{outcome.scenario.number:03d}"
        if not self.protocols:
            write_observation_set(observations, place / "observations")
        contents = {"diagnosis": outcome.diagnosis, "scenario": outcome.to_dict(full=True)}
        write_files(place, {f"{name}.json": json.dumps(content, indent=1) for name, content in contents.items()})


def with_observable_locations(effect: dict[str, Any]) -> dict[str, Any]:
    """An effect that shows only through another one (a wrong payload moves the elastic joints) is observable where that one acts."""
    coupling = declaration(effect["name"]).coupling
    return effect if coupling is None else {**effect, "observable_at": [where[0] for where in oracle.carriers(coupling, effect)]}


_challenger: Challenger | None = None


def _begin(plan: Path, protocols: bool, folder: Path | None) -> None:
    """In a new process, which leaves Ctrl-C to the one that started it."""
    global _challenger
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _challenger = Challenger.of(plan, protocols, folder)


def _take(scenario: Scenario) -> Outcome:
    assert _challenger is not None
    return _challenger.take(scenario)


def take_all(
    plan: Path,
    scenarios: Sequence[Scenario],
    protocols: bool = False,
    folder: Path | None = None,
    jobs: int = 1,
    progress: Callable[[Outcome], None] = lambda outcome: None,
) -> list[Outcome]:
    """All challenges, in the order of their scenarios; in ``jobs`` processes. Raises what stopped one."""
    out = []
    for outcome in _each(plan, scenarios, protocols, folder, jobs):
        progress(outcome)
        out.append(outcome)
    return out


def _each(plan: Path, scenarios: Sequence[Scenario], protocols: bool, folder: Path | None, jobs: int) -> Iterator[Outcome]:
    if jobs == 1:
        challenger = Challenger.of(plan, protocols, folder)
        yield from map(challenger.take, scenarios)
        return
    from loky import ProcessPoolExecutor

    pool, complete = ProcessPoolExecutor(jobs, initializer=_begin, initargs=(plan, protocols, folder)), False
    try:
        for taken in [pool.submit(_take, scenario) for scenario in scenarios]:
            yield taken.result()
        complete = True
    finally:
        pool.shutdown(wait=True, kill_workers=not complete)  # what was begun may take a minute, and nobody waits for it any more
