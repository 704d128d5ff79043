"""``mbcacq investigate``: measure, weigh, choose the next visit, in a loop, with the runner, the checks and the safety of a run."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbcacq.acquisition.device_check import refuse_impossible_devices
from mbcacq.design.adaptive.investigation import Budget, Decision, refuse_empty
from mbcacq.design.adaptive.investigation import decisions as decisions_of
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file
from mbcacq.model import yaml12
from mbcacq.model.json_text import fields_as_json, from_document, read_json
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, expand, load, refuse_errors
from mbcacq.plan.growth import with_steps
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.layout import INVESTIGATION_FILE
from mbcacq.recording.run_folder.lock import write_lock
from mbcacq.recording.run_folder.register import RunKind
from mbcacq.workflow import resume as resuming
from mbcacq.workflow.acquire import named_run_folder, new_run_folder
from mbcacq.workflow.address_space import refuse_small_address_space
from mbcacq.workflow.dry_run import MeasuredBefore, device_overrides, name_of
from mbcacq.workflow.evaluate import RunResult, evaluate
from mbcacq.workflow.investigation_page import PAGE, write_investigation_page
from mbcacq.workflow.load import as_plan, load_observations
from mbcacq.workflow.next_plan import plan_of_recording
from mbcacq.workflow.run import Operator, allowed_acquisition

if TYPE_CHECKING:
    from mbcacq.recording.rrd.choice_panel import WeighedPoses

FORMAT = "mbcacq-investigation/1"


@dataclass(frozen=True, kw_only=True)
class KeptInvestigation:
    """What the folder of a run keeps of an investigation, so that it can go on. plan: path; begun_with: text of the plan; the others as of
    ``CellInvestigation``."""

    plan: str
    budget: Budget
    begun_from_run: bool
    begun_with: str
    decisions: tuple[Decision, ...]


@dataclass(kw_only=True)
class CellInvestigation:
    """An investigation in the folder of a run: an iterator of decisions, each of them on the disk before its visit is measured.

    loaded: the plan of the cell. folder: of the run. budget, dry_run, seed, operator: as of ``mbcacq.investigate``. decisions: made so far.
    """

    loaded: LoadedPlan
    folder: Path
    budget: Budget
    dry_run: bool = False
    seed: int = 0
    live: bool = False
    operator: Operator = field(default_factory=Operator)
    decisions: list[Decision] = field(default_factory=list)
    begun_from_run: bool = False
    _settled: int = 0
    _begun: bool = False

    def __iter__(self) -> Iterator[Decision]:
        """Decisions, those of an interrupted investigation first. Raises what a run raises."""
        before = tuple(self.decisions)
        with ExitStack() as held:

            def hold() -> None:
                held.enter_context(write_lock(self.folder, "investigate"))
                self._keep()

            def begin() -> None:
                new_run_folder(self.folder, self.loaded.path.stem)
                hold()

            goes_on = self.begun_from_run or (self.folder / INVESTIGATION_FILE).exists()
            if goes_on:
                hold()
            self._settled = self._poses_settled(before)
            measured = load_observations(self.folder) if self.begun_from_run else None
            measure = self._measure if goes_on else partial(self._measure, begin=begin)
            for decision in decisions_of(self.loaded, measure, self.budget, before, measured, self.seed):
                if decision.number >= len(self.decisions):
                    self.decisions.append(decision)
                    self._keep()
                yield decision

    def finish(self) -> RunResult:
        """Measure the plan's poses that judge the calibration, calibrate and verify the cell, and write the page on how it was found."""
        judging = [] if self.begun_from_run else [s for s in yaml12.load(self.loaded.text)["steps"] if s["phase"] == "verification"]
        with write_lock(self.folder, "investigate"):
            if judging:
                grown = plan_of_recording(self.folder)
                if not any(step.phase == "verification" for step in grown.plan.steps):
                    self._settled = len(expand(grown))
                    grown = _grown(grown, judging)
                self._measure(grown)
            write_investigation_page(self.folder, self.loaded.plan.name, self.decisions)
            return evaluate(self.folder, self.loaded.plan.accept.sphere_spacing_error_mm, self.operator.progress)

    @property
    def page(self) -> Path:
        """The page on how it was found, once it is finished."""
        return self.folder / PAGE

    def _measure(self, grown: LoadedPlan, begin: Callable[[], None] = lambda: None) -> Observations:
        """Everything that is measured, after the poses that the plan has grown by. begin: called before the first, once nothing refuses."""
        operator = self.operator
        poses = expand(grown)
        refuse_errors(grown, poses)

        fresh = not layout.parts(self.folder)
        before = resuming.progress_before(None if fresh else self.folder, grown, name_of(self.dry_run, self.seed), operator.message)
        settled = frozenset(range(self._settled))
        # A fake cell measures the whole of an interrupted visit once more: it does again what it would have done.
        done = settled if self.dry_run else before.done | settled
        if any(p.number not in done for p in poses):
            acquisition = allowed_acquisition(operator, grown, poses, done, before.part, self.dry_run, self.seed)
            acquisition.folder, acquisition.kind = self.folder, RunKind.INVESTIGATION
            acquisition.weighed = self._weighed([p for p in poses if p.number not in done])
            known = MeasuredBefore.of(load_observations(self.folder), done) if self.dry_run and done else None
            with device_overrides(grown, poses, self.dry_run, self.seed, operator.assume_yes, known) as overrides:
                if not self._begun:
                    begin()
                    operator.began(self.folder)
                    self._begun = True
                acquisition.execute(overrides, operator.subscribers, live=self.live, message=operator.message, pause=operator.pause)
        self._settled = len(poses)
        operator.progress("weighing all explanations")
        return load_observations(self.folder)

    def _weighed(self, ahead: Sequence[PlannedPose]) -> WeighedPoses | None:
        """What the panel of the recording shows beside the poses that come; None before the first decision."""
        from mbcacq.recording.rrd.choice_panel import WeighedPoses

        if not self.decisions:
            return None
        cell, last = self.loaded.cell, self.decisions[-1]
        scanner = cell.robot.chain.flange(np.array([p.q for p in ahead])) @ cell.T_flange_scanner
        body = self.loaded.plan.scanner.field_of_view.body_mm
        above = np.array([0.0, 0.0, body[0][2] if body else 0.0])
        looks = np.stack([scanner[:, :3, 3] + scanner[:, :3, :3] @ above, scanner[:, :3, 3]], axis=1)
        return WeighedPoses(last.sets, last.hiding, looks)

    def _poses_settled(self, before: Sequence[Decision]) -> int:
        """Poses of the plan that are measured or were left out for good: all but those of the last decision, which may be incomplete."""
        if not before:
            return 0
        grown = plan_of_recording(self.folder)
        poses = expand(grown) if self.begun_from_run else [p for p in expand(grown) if p.phase != "verification"]
        last = before[-1].steps
        begun = bool(last) and any(step.name == last[-1]["name"] for step in grown.plan.steps)
        return len(poses) - sum(len(step["poses_deg"]) for step in last) if begun else len(poses)

    def _keep(self) -> None:
        kept = KeptInvestigation(
            plan=str(self.loaded.path.absolute()),
            budget=self.budget,
            begun_from_run=self.begun_from_run,
            begun_with=self.loaded.text,
            decisions=tuple(self.decisions),
        )
        content = {"format": FORMAT} | fields_as_json(kept)
        write_file(self.folder / INVESTIGATION_FILE, json.dumps(content, indent=1) + "\n")


def _grown(grown: LoadedPlan, steps: list[dict[str, Any]]) -> LoadedPlan:
    return replace(load(grown.path, with_steps(grown, steps)), grown_from=grown.grown_from)


def investigate(  # noqa: PLR0913 -- one argument an option of its command
    plan: LoadedPlan | Path | str | None,
    budget: Budget | None = None,
    *,
    out: Path | str | None = None,
    resume: Path | str | None = None,
    recording: Path | str | None = None,
    dry_run: bool = False,
    seed: int = 0,
    live: bool = False,
    operator: Operator | None = None,
) -> CellInvestigation:
    """Begin an investigation: measure, weigh all explanations, choose the next visit of a station, until the cell is known.

    It measures the best 24 poses of a plan and chooses every further visit among the views that can be taken. It ends when the cell is
    known, the budget is spent, or no pose that can be reached would decide more.

    Parameters
    ----------
    plan
        The plan of the cell; not needed with ``resume`` or ``recording``.
    budget
        Most poses, moves and minutes.
    out
        The folder of the run.
    resume
        The folder of an interrupted investigation, whose decisions are replayed.
    recording
        The folder of a finished run, which is continued.
    dry_run, seed, live, operator
        As for ``mbcacq.run``.

    Returns
    -------
    CellInvestigation
        An iterator of decisions. Each is followed by the visit that it chose. Call ``finish`` at the end.

    Raises
    ------
    ConfigError
        The arguments do not fit together. Iterating raises what a run raises.
    """
    refuse_small_address_space()
    budget = budget or Budget()
    refuse_empty(budget)
    if sum(given is not None for given in (out, resume, recording)) > 1:
        raise ConfigError("--out, --resume and --from exclude each other: an investigation goes on in the folder that it began in")
    begin = partial(CellInvestigation, dry_run=dry_run, seed=seed, live=live, operator=operator or Operator())
    if resume is not None:
        return _resumed(Path(resume), begin)
    if recording is not None:
        folder = Path(recording)
        return begin(loaded=_from_run(folder), folder=folder, budget=budget, begun_from_run=True)
    if plan is None:
        raise ConfigError("there is no plan to investigate with; give one, or --from RUN")
    loaded = as_plan(plan)
    if not dry_run:
        refuse_impossible_devices(loaded)
    return begin(loaded=loaded, folder=named_run_folder(None if out is None else Path(out), loaded.path.stem), budget=budget)


def _from_run(folder: Path) -> LoadedPlan:
    loaded = plan_of_recording(folder)
    return replace(loaded, grown_from=loaded.grown_from or len(expand(loaded)))


def _resumed(folder: Path, begin: Callable[..., CellInvestigation]) -> CellInvestigation:
    """An interrupted investigation, with its budget and the decisions that it has made."""
    file, cure = folder / INVESTIGATION_FILE, f"go on with the run: mbcacq investigate --from {folder}"
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{folder} holds no investigation to resume; give its folder, or --from RUN for a finished run") from None
    except ValueError as error:
        raise ConfigError(f"{file} is damaged (it is not UTF-8 text); {cure}") from error
    kept = from_document(KeptInvestigation, read_json(text, str(file), cure), FORMAT, str(file), "investigation", cure)
    loaded = load(Path(kept.plan), kept.begun_with)
    if kept.begun_from_run:
        loaded = replace(loaded, grown_from=plan_of_recording(folder).grown_from or len(expand(loaded)))
    return begin(loaded=loaded, folder=folder, budget=kept.budget, decisions=list(kept.decisions), begun_from_run=kept.begun_from_run)
