"""Findings: what the checks report about a plan, each with its place in the YAML."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from mbcacq.model.json_text import AsJson
from mbcacq.plan.planned import LoadedPlan, PlannedPose

Level = Literal["error", "warning", "info"]
LEVELS = ("error", "warning", "info")  # the worst first


@dataclass(frozen=True, kw_only=True)
class PlanFinding(AsJson):
    """level: 'error' keeps the plan from being run. code: stable name for programs. place: 'file:line'. poses: numbers concerned."""

    level: Level
    code: str
    step: str
    place: str
    sentence: str
    poses: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.place}: {self.sentence}"


def finding(loaded: LoadedPlan, pose: PlannedPose, level: Level, code: str, sentence: str) -> PlanFinding:
    """A finding about one pose, named by its step and station."""
    where = f"step '{pose.step_name}' at station '{pose.station}': "
    return PlanFinding(
        level=level, code=code, step=pose.step_name, place=f"{loaded.path}:{pose.line}", sentence=where + sentence, poses=(pose.number,)
    )


def merged(findings: list[PlanFinding]) -> list[PlanFinding]:
    """Findings of one kind about one step as one: the first one's sentence, all poses; worst level first, then in the plan's order."""
    first: dict[tuple[str, str, str], PlanFinding] = {}
    for finding in findings:
        known = first.setdefault(key := (finding.level, finding.code, finding.step), finding)
        if known is not finding:
            first[key] = replace(known, poses=known.poses + finding.poses)
    return sorted(map(_with_count, first.values()), key=lambda finding: LEVELS.index(finding.level))


def _with_count(finding: PlanFinding) -> PlanFinding:
    more = len(finding.poses) - 1
    if more < 1:
        return finding
    return replace(finding, sentence=f"{finding.sentence} (and {more} more pose{'s' if more > 1 else ''} of this step)")
