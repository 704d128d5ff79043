"""The search for effects in motion: candidates of a group of channels in the shared search over sets, one linearisation at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import EvidenceSearch
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, estimated, is_common, under
from mbcacq.diagnosis.motion.gram_point import RATIOS, SHARES, ConditionedGram
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.bayes_factor import log_bayes_factors
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate

# Log Bayes factor L at the noise of a set with the effect. Without it the noise of n samples that count grows, and what remains is about
# n/2 log(1 + 2 L / n): with ten samples still 13, which no prior of a set outweighs.
BEYOND_DOUBT = 60.0

ODDS_OF_COMMON = 0.5  # beforehand, that what every arm has is large enough to show

Forms = tuple[Member, ...]  # a candidate at all values of its hyper-parameter


def sized(member: Member, prior: np.ndarray, information: np.ndarray) -> Member:
    """An effect in typical sizes: its prior where it has one, else what is as large as the noise.

    prior, information: (P,) of all columns.
    """
    sigma = prior[member.columns]
    bounded = bool(np.isfinite(sigma).all())
    typical = sigma if bounded else 1.0 / np.sqrt(np.maximum(information[member.columns], 1e-300))
    candidate = replace(member.candidate, rows=replace(member.candidate.rows, typical=typical))
    return replace(member, candidate=candidate, sizes=SHARES if bounded else RATIOS, size=1.0)


def that_show(forms: Forms, information: np.ndarray) -> Forms:
    """The variants of a candidate that change any sample; of others there is no size to be compared. information: (P,) of all columns."""
    return tuple(one for one in forms if (information[one.columns] > 0).all())


def log_prior_mass(candidates: Sequence[Forms]) -> float:
    """Log of the most that the priors of all sets can add up to, by which an e-value is divided: the common effects in any number."""
    common = {forms[0].candidate.location for forms in candidates if is_common(forms[0].candidate)}
    return len(common) * float(np.log1p(ODDS_OF_COMMON))


@dataclass(kw_only=True)
class MotionSearch(EvidenceSearch):
    """The candidates of a group of channels. Each further effect asks for another linearisation and colour of the noise, so the search
    itself only leaves out and exchanges (``effect_selection`` makes a set larger).
    """

    most_effects: ClassVar[int] = 40  # more have never been found

    candidates: list[Forms]
    settle: bool = False

    def begun(self, best: Hypothesis) -> Hypothesis:
        return self.pruned(self.settled(best) if self.settle else best)

    def climbed_to_the_best(self, best: Hypothesis) -> Hypothesis:
        """The set itself; where alternatives are asked for, larger sets count in the e-value."""
        if self.alternatives:
            self.grown([best], self.candidates)
        return best

    def looked_at(self, members: Sequence[Member], best: Hypothesis) -> Hypothesis:
        """The noise is estimated too: an effect may lower it a hundredfold, and a linear step does not show that."""
        return self.estimated(members, best.point)

    def may_matter(self, log_posterior: float, best: Hypothesis) -> bool:
        return log_posterior > best.log_posterior - OPTIONS.reach

    def doubtful(self, best: Hypothesis, member: Member) -> bool:
        """Not if its Bayes factor is beyond doubt at the noise of the set, with however much noise it is explained without the effect."""
        rest = best.point.conditioned([m for m in best.members if m is not member])
        return float(self.log_factors(rest, [member])[0]) < BEYOND_DOUBT

    def settled(self, best: Hypothesis, first: int = 0) -> Hypothesis:
        """The set with most probable hyper-parameters: one effect after the other, from number ``first`` on, at the remaining noise.
        Without the effect, the noise hides which value fits best.
        """
        members = list(best.members)
        for i, member in list(enumerate(members))[first:]:
            forms = next((f for f in self.candidates if f[0].candidate.form == member.candidate.form and len(f) > 1), ())
            tried = [replace(one, log_mass=-float(np.log(len(forms)))) for one in forms]
            sets = [under(best.point, (*members[:i], one, *members[i + 1 :]), 0.0) for one in tried]
            if sets:
                members[i] = tried[int(np.argmax([h.log_evidence for h in sets]))]
        found = estimated(tuple(members), best.point, best.log_prior)
        self.known[found.key] = found
        return found

    def further(self, node: Hypothesis, candidates: list[Forms], least: float) -> list[tuple[float, Member]]:
        present = [m.candidate for m in node.members]
        possible = [forms for forms in candidates if self.allowed(forms[0].candidate, present)]
        logs = self.log_factors(node.conditioned, [one for forms in possible for one in forms])
        out, first = [], 0
        for forms in possible:
            out.append(self.averaged(forms, logs[first : first + len(forms)], present))
            first += len(forms)
        return [(log, member) for log, member in out if log > -np.inf]

    def averaged(self, forms: Forms, logs: np.ndarray, present: Sequence[Candidate]) -> tuple[float, Member]:
        """Log posterior odds over all values of the hyper-parameter, and the effect at the most probable one.

        The prior is shared by as many values as were compared to find these.
        """
        best = int(logs.argmax())
        hyper = forms[0].candidate.hyper
        total = float(np.logaddexp.reduce(logs)) - float(np.log(max(1.0 if hyper is None else hyper.independent, len(forms))))
        member = replace(forms[best], log_mass=total - float(logs[best]))
        return total + self.prior.log_probability(member.candidate, present), member

    def allowed(self, candidate: Candidate, present: Sequence[Candidate]) -> bool:
        """One plain form of an effect at a location, then its refinements, each form once."""
        if candidate.form in {other.form for other in present}:
            return False
        plain = any(not other.rows.extends and other.location == candidate.location for other in present)
        return plain if candidate.rows.extends else (not plain or candidate.several)

    @staticmethod
    def log_factors(problem: ConditionedGram, members: Sequence[Member]) -> np.ndarray:
        """(H,) log Bayes factors of single effects, averaged over sizes; -inf where the first coefficient has the wrong sign."""
        out = np.zeros(len(members))
        kinds: dict[tuple, list[int]] = {}
        for i, m in enumerate(members):
            kinds.setdefault((m.candidate.k, m.sizes, m.candidate.positive), []).append(i)
        for (k, sizes, positive), own in kinds.items():
            typical = np.stack([members[i].candidate.typical for i in own])
            A, a = problem.beyond(np.stack([members[i].columns for i in own]))
            A, a = A * typical[:, :, None] * typical[:, None, :], a * typical
            logs = log_bayes_factors(A, a, np.array(sizes), positive)
            if positive and k > 1:
                x = np.linalg.solve(A + np.eye(k) / max(sizes) ** 2, a[:, :, None])[:, 0, 0]
                logs = np.where(x > 0, logs, -np.inf)
            out[own] = logs
        return out
