"""Members of a set of effects that no longer pay, taken back."""

from __future__ import annotations

from scipy.stats import chi2

from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects.pose import payload

SIGNIFICANT = 0.001  # own p-value beyond which a member is not told, whatever it was found with
LIKELY = 0.05  # the same where there is known to be an effect


def pruned(search: BeamSearch, screen: CandidateScoring, model: EffectSet) -> EffectSet:
    """Without the members that no longer pay, one by one, under the noise and beside whatever was found in the end.

    screen: may have groups without a name projected out, which can make a name superfluous that was needed before them.
    """
    model = search.solve(screen, model.members, permit=True)
    while model.members:
        rest = {j: search.solve(screen, model.members[:j] + model.members[j + 1 :], permit=True) for j in removable(model)}
        dead = [m for j, m in rest.items() if lost(model, m, j) > required(search, model, m)]
        free = [m for j, m in rest.items() if not search.is_protected(model, j)]
        best = max(dead or [m for m in free if m.score > model.score], key=lambda m: m.gain if dead else m.score, default=None)
        if best is None:
            break
        model = best
    return model


def removable(model: EffectSet) -> list[int]:
    """Numbers of the members; a wrong tool and the elasticity beside it stay together on purpose."""
    together = (payload.NAME, "joint_compliance") if payload.NAME in model.names else ()
    return [j for j, (c, _) in enumerate(model.members) if c.name not in together]


def required(search: BeamSearch, model: EffectSet, rest: EffectSet) -> float:
    """p-value that a member must reach; a mild one if without it what is left would not pass the test that all of them pass."""
    carries = rest.members and model.score > search.nothing.score >= rest.score
    return LIKELY if search.allowance or carries else SIGNIFICANT


def lost(model: EffectSet, rest: EffectSet, j: int) -> float:
    """p-value of member j beside the others: chi2 that is lost without it."""
    return float(chi2.sf(max(model.gain - rest.gain, 0.0), model.members[j][0].k))
