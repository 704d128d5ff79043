"""Effects outside the catalogue as candidates like any other: design blocks at every location, averaged over their shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.evidence.hypothesis import UNMODELLED, Hypothesis, Member, conditioned
from mbcacq.diagnosis.nonparametric import gaussian_process, locations
from mbcacq.diagnosis.nonparametric.bayes_factor import SIZES
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup, DesignBlocks
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap, MapCell, MapEvidence
from mbcacq.diagnosis.nonparametric.gaussian_process import Process
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.effect import Candidate, Part

MOST_LOCATIONS = 5  # the best of which are candidates


@dataclass
class UnmodelledEffects:
    """The design blocks of a recording, and the evidence map of the noise that was asked for last."""

    design_blocks: DesignBlocks
    _map: EvidenceMap | None = None

    @property
    def locations(self) -> int:
        return len(self.design_blocks.log_prior_shares)

    def map(self, projected: CandidateScoring) -> EvidenceMap:
        if self._map is None or self._map.projected.Q is not projected.Q:
            self._map = EvidenceMap(projected, self.design_blocks)
        return self._map

    def evidence(self, projected: CandidateScoring, least: float = -np.inf) -> list[tuple[float, Member]]:
        """Log Bayes factor at each of the best locations, averaged over shapes, and the best block there.

        least: below which an effect does not matter.
        """
        evidence_map = self.map(projected)
        found = evidence_map.evaluate(projected, least)
        out = []
        for location, log in [(at, log) for at, log in found.locations.items() if log > least][:MOST_LOCATIONS]:
            cell = found.best_at(location)
            out.append((log, self.member(evidence_map, cell, log - cell.log_bayes_factor)))
        return out

    def process(self, projected: CandidateScoring, member: Member) -> Member | None:
        """The most probable Gaussian process at the location of an unmodelled effect, in its place; None where none is known.

        Its covariates and length are chosen with one component of the location at a time, and then the components that move together;
        what is not looked at is as if it had no evidence.
        """
        context = self.design_blocks.context
        location = next((at for at in locations.of_arm(context) if at.name == member.candidate.where[0]), None)
        possible = [] if location is None else gaussian_process.processes(context, location, member.candidate.depends_on)
        if location is None or not possible:
            return None

        def evaluated(chosen: Sequence[Process], variants: Sequence[tuple[int, ...]], most: int) -> tuple[EvidenceMap, MapEvidence]:
            evidence_map = EvidenceMap(projected, gaussian_process.blocks(context, location, chosen, variants, most))
            return evidence_map, evidence_map.evaluate(projected)

        alone = [rows for rows in location.variants if len(rows) == 1]
        together = [rows for rows in location.variants if len(rows) > 1]
        tried, found = evaluated(possible, alone, gaussian_process.COMPARED)
        best, logs = found.best(), found.log_bayes_factor
        (entries,) = (group.entries for group in tried.design_blocks.groups)
        process = possible[next(j for j, (_, _, shape) in enumerate(entries) if shape is best.shape)]
        if together:
            _, found = evaluated([process], together, gaussian_process.COMPARED)
            best = max(best, found.best(), key=lambda cell: cell.log_bayes_factor)
            logs = np.concatenate([logs, found.log_bayes_factor])
        average = float(np.logaddexp.reduce(logs)) - float(np.log(len(location.variants) * len(possible)))
        whole, found = evaluated([process], [best.rows], gaussian_process.MOST_FUNCTIONS)
        described = gaussian_process.described(location, best.rows, process, gaussian_process.MOST_FUNCTIONS)
        member = self.member(whole, found.best(), average - best.log_bayes_factor)
        variant = f"{process.label} at {best.rows}"
        return replace(member, candidate=replace(member.candidate, variant=variant, described=lambda _: described))

    def processes(self, best: Hypothesis) -> list[Member]:
        """The Gaussian process at each location of the unmodelled effects of a set: the one that it has, or would be the most probable."""
        found = {m.label: m for m in best.unmodelled if m.candidate.described is not None}
        for member in best.unmodelled:
            if member.label not in found:
                others = [m for m in best.members if m.label != member.label]
                process = self.process(conditioned(best.point, others), member)
                found |= {member.label: process} if process is not None else {}
        return list(found.values())

    def member(self, evidence_map: EvidenceMap, cell: MapCell, log_mass: float) -> Member:
        """A block as an effect. Its sizes are those of the map, relative to the best determined direction."""
        group = evidence_map.design_blocks.groups[cell.group]
        rows = np.array(cell.rows)
        typical = np.tile(cell.shape.weight, len(rows)) / np.sqrt(np.maximum(evidence_map.raw_of(cell), 1e-300))
        parts = parts_of(group, rows, cell.shape.index)
        label = f"{cell.group} {cell.rows} {tuple(cell.shape.index)}"
        candidate = Candidate(
            UNMODELLED, (cell.location,), cell.depends_on, lambda _: parts, lambda c, v, h: {}, typical, several=True, variant=label
        )
        _, S, _ = evidence_map.projected.candidate_products(candidate, None)
        top = max(float(np.linalg.eigvalsh(S * np.outer(typical, typical))[-1]), 1e-6)
        return Member(candidate, None, log_mass, tuple(float(v) for v in np.sqrt(SIZES / top)))


def parts_of(group: BlockGroup, rows: np.ndarray, index: np.ndarray) -> list[Part]:
    """The columns of some rows of a group's mix by some of its functions, component by component."""
    F = group.functions[:, index]
    parts = []
    for c, (place, number, component) in enumerate(group.keys):
        mix = group.mix[rows, c]
        if np.any(mix):
            parts.append(Part(place, number, component, (mix[:, None] * F[:, None, :]).reshape(len(F), -1)))
    return parts
