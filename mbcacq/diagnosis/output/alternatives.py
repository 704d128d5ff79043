"""What else could stand in an effect's place, and what these poses could not have shown."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis import noise_consistent_ranking
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects.effect import Candidate

VISIBLE = 2.0  # chi2 that an effect of typical size must make at least, or it would not be seen even several times as large
STRONG = 10.0  # times the typical size
UNDECIDED = 2 * float(np.log(20.0))  # an alternative that is more than a twentieth as probable is not excluded


def unseen(setup: DiagnosisProblem, full: ModelFit) -> list[tuple[Candidate, float, bool]]:
    """Elastic main joints that would not show at their typical size, with the share of their effect that geometry leaves, and whether
    even a strong one would not show.
    """
    out = []
    if not setup.context.masses_known:
        return out
    elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
    strongest = sorted(elastic, key=lambda c: -np.ptp(setup.context.gravity_torque[:, int(c.where[0][1:]) - 1]))[:1]
    for candidate in strongest:
        information = 1 / max(full.geometry_only.test(candidate).covariance[0, 0], 1e-300)
        seen = candidate.typical[0] ** 2 * information
        if seen < VISIBLE:
            X = full.geometry_only.block(candidate, None)
            out.append((candidate, float(np.clip(information / np.sum(X * X), 0, 1)), bool(STRONG**2 * seen < VISIBLE)))
    return out


def rivals(setup: DiagnosisProblem, full: ModelFit) -> tuple[dict[str, list[dict]], list[dict], list]:
    """For each named effect: what else, or the same elsewhere, could stand in its place; the pairs that cannot be told apart, in words and
    as found.
    """
    alternatives: dict[str, list[dict]] = {}
    inseparable: list[dict] = []
    pairs: list = []
    model = full.model
    if not model.effects or len(model.effects) > 6:
        return alternatives, inseparable, pairs
    search = BeamSearch(setup.candidates)
    excess = max(full.geometry_only.chi2 - full.geometry_only.dof, 1e-9)
    for name in model.names:
        mine = [j for j, (c, _) in enumerate(model.effects) if c.name == name]
        rest = search.solve(full.geometry_only, tuple(m for j, m in enumerate(model.effects) if j not in mine))
        if rest is None:
            continue
        lost = model.gain - rest.gain
        places = {w for j in mine for w in model.effects[j][0].where}
        seen = set()
        for scored in search.expand(full.geometry_only, rest):
            candidate = scored.candidate
            itself = candidate.name == name and places.intersection(candidate.where)
            if itself or candidate.name in seen or len(seen) == 3:
                continue
            seen.add(candidate.name)
            alternatives.setdefault(name, []).append(
                {"name": candidate.name, "where": list(candidate.where), "held_out_gain": float(np.clip(scored.gain / excess, 0, 1))}
            )
            swapped = search.solve(full.geometry_only, (*rest.effects, (candidate, scored.hyper)))
            if swapped is not None and not excluded(setup, full, search, swapped):
                inseparable.append(
                    {
                        "effects": [f"{name}:{'+'.join(model.effects[mine[0]][0].where)}", f"{candidate.name}:{'+'.join(candidate.where)}"],
                        "correlation": float(np.clip(scored.gain / max(lost, 1e-9), 0, 1)),
                    }
                )
                first, hyper = model.effects[mine[0]]
                pairs.append(((first, hyper, model.coefficients[model.slices()[mine[0]]]), (candidate, scored.hyper, scored.coefficients)))
    return alternatives, inseparable, pairs


def excluded(setup: DiagnosisProblem, full: ModelFit, search: BeamSearch, other: EffectSet) -> bool:
    """Whether another set of names is less than a twentieth as probable as the one told, each under the noise that it leaves."""
    if other.log_posterior_odds < full.model.log_posterior_odds - noise_consistent_ranking.MAX_DEFICIT:
        return True
    if full.smooth is not None:  # the noise is that of what has no name
        return other.log_posterior_odds < full.model.log_posterior_odds - UNDECIDED
    linear = full.geometry_only.linear
    there, solved = noise_consistent_ranking.under_own_noise(search, linear, other, full.noise, setup.prior_noise)
    if solved is None:
        return True
    told = noise_consistent_ranking.log_posterior(full.geometry_only, full.model, setup.prior_noise)
    return noise_consistent_ranking.log_posterior(there, solved, setup.prior_noise) < told - UNDECIDED
