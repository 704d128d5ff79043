"""Effects outside the catalogue as candidates like any other: design blocks at every location, averaged over their shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.nonparametric import gaussian_process
from mbcacq.diagnosis.nonparametric.basis_functions import locations_of_arm
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup, DesignBlocks, unmodelled_candidate
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap, MapEvidence, without_rounding
from mbcacq.diagnosis.nonparametric.gaussian_process import Process
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.bayes_factor import relative_sizes
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate


@dataclass
class UnmodelledEffects:
    """The design blocks of a recording, and the evidence map of the noise that was asked for last."""

    design_blocks: DesignBlocks
    _map: EvidenceMap | None = None

    def map(self, projected: CandidateScoring) -> EvidenceMap:
        if self._map is None or self._map.projected.Q is not projected.Q:
            self._map = EvidenceMap(projected, self.design_blocks.groups)
        return self._map

    def evidence(self, projected: CandidateScoring, least: float = -np.inf) -> list[tuple[float, Member]]:
        """Log Bayes factor at each of the best locations, averaged over shapes, and the best block there.

        least: below which an effect does not matter.
        """
        found = self.map(projected).evaluate(projected)
        out = []
        for at, log in [(at, log) for at, log in found.locations.items() if log > least][: OPTIONS.estimated]:
            best = found.best_at(at)
            candidate = self.design_blocks.candidate(best)
            out.append((log, relative_to_best_determined(projected, candidate, log - float(found.log_bayes_factor[best]))))
        return out

    def process(self, projected: CandidateScoring, member: Member) -> Member | None:
        """The most probable Gaussian process at the location of an unmodelled effect, in its place; None if none is known.

        Its covariates and length are chosen with one component of the location at a time, and then the components that move together;
        what is not looked at is as if it had no evidence.
        """
        context, at = self.design_blocks.context, member.candidate.where[0]
        location = {one.name: one for one in locations_of_arm(context)}.get(at)
        possible = gaussian_process.processes(context, location, member.candidate.depends_on) if location else []
        if location is None or not possible:
            return None

        def compared(chosen: Sequence[Process], variants: list[tuple[int, ...]]) -> MapEvidence:
            shapes = [process.shape(context) for process in chosen]
            return EvidenceMap(projected, [BlockGroup(replace(location, variants=tuple(variants)), shapes)]).evaluate(projected)

        found = compared(possible, [rows for rows in location.variants if len(rows) == 1])
        best, logs = found.blocks[found.best_at(at)], found.log_bayes_factor
        process = next(one for one in possible if one.label == best.shape.depends_on)
        rows = best.rows
        together = [rows for rows in location.variants if len(rows) > 1]
        if together:
            found = compared([process], together)
            rows = found.blocks[found.best_at(at)].rows
            logs = np.concatenate([logs, found.log_bayes_factor])
        average = float(np.logaddexp.reduce(logs)) - float(np.log(len(location.variants) * len(possible)))
        columns, sigma = process.functions(gaussian_process.MOST_FUNCTIONS)
        parts = location.described(rows, columns)
        sigma, label = np.tile(sigma, len(rows)), f"{process.label} at {rows}"
        candidate = unmodelled_candidate(at, process.depends_on, parts, sigma, label)
        return relative_to_best_determined(projected, candidate, average - float(logs.max()))


def relative_to_best_determined(projected: CandidateScoring, candidate: Candidate, log_mass: float = 0.0) -> Member:
    """The effect with sizes relative to its best determined direction. candidate: its ``typical`` (k,) are relative prior sigmas of
    coefficients in units of what they move.
    """
    X, S, _ = projected.candidate_products(candidate, None)
    typical = candidate.typical / np.sqrt(without_rounding(np.sum(X * X, axis=0)))
    sizes = relative_sizes(np.linalg.eigvalsh(S * np.outer(typical, typical))[-1:])[0]
    return Member(replace(candidate, rows=replace(candidate.rows, typical=typical)), None, log_mass, tuple(sizes.tolist()))
