"""Sentences for people: what was left out of a diagnosis, what qualifies the effects that were found, what was not tested."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.effect_found import EffectFound, MismatchEntry
from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.between_sets import better_in_general
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import MOST_LOG_ODDS, coupled_instead, reported_hypothesis
from mbcacq.diagnosis.findings import LOOK_AT, Advice
from mbcacq.diagnosis.model_fit import ModelFit, joint_noise_factor
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.kept_model import partly_covered
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import NoiseDependence
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore
from mbcacq.effects import catalogue
from mbcacq.effects.effect import FADING
from mbcacq.effects.functions import periods_covered
from mbcacq.effects.in_words import effect_in_words, odds_in_words
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import first_noise
from mbcacq.model.observations import Observations
from mbcacq.quantities import K, in_degrees, micrometres, p_value, significant, with_unit

UNSAID = 0.02  # share of which nothing is said: shares are printed in per cent
SIGNIFICANT = 3.0  # standard deviations from which it is
MOST_POSES = 8  # whose numbers are listed
PAUSE_S = 900.0  # from pose to pose, from which the recording is said to pause


def notes(setup: DiagnosisProblem, full: ModelFit) -> list[str]:
    """Sentences on what was left out of the diagnosis."""
    out = [f"{name} was not considered: {reason}" for name, reason in setup.dropped.items()]
    wrong = stated_noise_is_wrong(full, first_noise(setup.linear.obs.cell))
    if wrong is not None:
        out.append(wrong)
    factor = joint_noise_factor(full)
    if factor > 1.0:
        out.append(
            f"the joints repeat {significant(factor, 2)} times worse than the data sheet (repeatability_mm) has it: something of which no "
            "model was found is in this noise; visit some poses several times, in different order and after different pauses"
        )
    keep = full.geometry_only.linear.keep
    if open_ones := [u.name for u in setup.undetermined if not u.harmless]:
        out.append(f"the poses do not determine {', '.join(open_ones)}: held at the nominal value")
    dropped = int(np.sum(~keep))
    if dropped:
        rejected = "is a gross outlier and was rejected" if dropped == 1 else "are gross outliers and were rejected"
        out.append(f"{dropped} of {len(keep)} measured centres {rejected}")
        obs = full.geometry_only.linear.obs
        out += rejected_poses(obs, keep)
    out += single_place(setup)
    if not setup.context.masses_known:
        out.append(
            "no masses given: elasticity under gravity was tested with one kilogram halfway along each link; "
            "its size in rad/Nm is not meaningful"
        )
    return out


def rejected_poses(obs: Observations, keep: np.ndarray) -> list[str]:
    """A sentence where all centres of a pose were rejected, several at least: wrong centres are wrong by themselves.

    keep: (M,) bool of the centres that took part.
    """
    count, kept = (np.bincount(obs.pose[chosen], minlength=obs.n_poses) for chosen in (slice(None), keep))
    whole = obs.pose_id[(count > 1) & (kept == 0)]
    if not len(whole):
        return []
    named = ", ".join(map(str, whole[:MOST_POSES])) + (", .." if len(whole) > MOST_POSES else "")
    which = f"pose {named}" if len(whole) == 1 else f"{len(whole)} poses ({named})"
    return [
        f"all centres of {which} were rejected: that may be an effect of few poses, of which this diagnosis then says nothing; look at them"
    ]


def rejected_balls(obs: Observations, keep: np.ndarray) -> list[Advice]:
    """What to do about each ball of which most centres were rejected: no noise does so. keep: as of ``rejected_poses``."""
    count, kept = (np.bincount(obs.ball[chosen], minlength=len(obs.cell.ball_ids)) for chosen in (slice(None), keep))
    return [
        Advice(
            f"{LOOK_AT}{obs.cell.ball_ids[k]} and its seat, it may be loose or damaged: {count[k] - kept[k]} of its {count[k]} centres "
            "were rejected, and this diagnosis says nothing of them",
            (),
        )
        for k in np.flatnonzero((count > 1) & (2 * kept < count))
    ]


def of_effects(setup: DiagnosisProblem, full: ModelFit, effects: Sequence[EffectFound]) -> list[str]:
    """Sentences on what qualifies the effects found."""
    if not effects:
        return []
    reported = reported_hypothesis(full.evidence)
    return [
        *dict.fromkeys(m.candidate.support.refused for m in reported.unmodelled if m.candidate.support.refused),
        *other_covariates(full.evidence, reported),
        *(
            f"a general function at {at} predicts better than the names there ({odds_in_words(float(np.exp(min(log, MOST_LOG_ODDS))))}): "
            "they only come near to what happens"
            for at, log in better_in_general(full.evidence, reported).items()
        ),
        *partial_periods(setup, full),
        *unfinished_warm_ups(setup, effects),
        *confounded_pauses(setup.linear.obs, effects),
        *bent_artefacts(setup.linear.obs, effects),
        *(c.advice.format(odds=odds_in_words(odds)) for c, odds in coupled_instead(full.evidence, reported)),
    ]


def other_covariates(fit: EvidenceFit, reported: Hypothesis) -> list[str]:
    """One sentence for each reported effect that depends on another recorded quantity about as probably (two thermometers, say)."""
    own = {m.label: m.candidate.depends_on for m in reported.catalogued}
    found: dict[tuple[str, str], float] = {}
    for h in fit.hypotheses:
        odds = h.log_posterior - reported.log_posterior
        if h.labels == reported.labels and odds > np.log(OPTIONS.undecided):
            for m in h.catalogued:
                if (cause := m.candidate.depends_on) != own[m.label]:
                    found[m.label, cause] = max(float(np.exp(odds)), found.get((m.label, cause), 0.0))
    return [
        f"{effect_in_words(label)} may depend on {cause} in place of {own[label]} ({odds_in_words(odds)})"
        for (label, cause), odds in found.items()
    ]


def stated_noise_is_wrong(full: ModelFit, stated: Noise) -> str | None:
    """One sentence where the estimated noise is not what is stated of the instrument; None if it is, or where nothing is stated."""
    linear = full.geometry_only.linear
    if linear.obs.cell.noise_mm is None or linear.obs.noise_scale is not None:
        return None  # one figure would be wrong wherever it is stated
    ratio = float(np.exp(np.mean(np.log(full.noise.point / stated.point))))
    sd = 1.0 / np.sqrt(2.0 * max(full.geometry_only.dof, 1.0))
    if abs(np.log(ratio)) < max(np.log(OPTIONS.noticeable), SIGNIFICANT * sd):
        return None
    instrument = "scanner" if linear.width == 3 and linear.obs.cell.measurement != "target_in_base" else "instrument"
    found = np.sqrt(np.mean(full.noise.point**2))
    factor = f"{significant(ratio, 2)} times" if ratio > 1 else f"1/{significant(1 / ratio, 2)} of"
    size = f"{micrometres(float(found))} along each axis"
    return f"the noise of the {instrument} is {factor} what is stated: {size}; correct noise_mm in cell.yaml"


def noise_in_words(found: Sequence[NoiseDependence], weighted: bool = True) -> list[str]:
    """A sentence for each noise that depends on the place. weighted: whether each pose has its own in everything else."""
    used = "each pose is weighted by its own noise" if weighted else "a recording of this length keeps one noise for all poses"
    out = []
    for one in found:
        what = "the noise of the instrument" if one.of == "instrument" else "the noise of whole poses (joints and instrument)"
        ratio = max(one.sigma_low_mm, one.sigma_high_mm) / min(one.sigma_low_mm, one.sigma_high_mm)
        grows = "grows" if one.sigma_high_mm > one.sigma_low_mm else "falls"
        high = with_unit(f"{one.high:.0f}", one.unit)
        ends = f"from {one.low:.0f} to {high} it is {significant(ratio, 2)} times as large ({p_value(one.p_value)})"
        ends = ends if grows == "grows" else ends.replace("times as large", "times smaller")
        sizes = f": {micrometres(one.sigma_low_mm)} and {micrometres(one.sigma_high_mm)} along each axis" if one.of == "instrument" else ""
        out.append(f"{what} {grows} with the {one.covariate}: {ends}{sizes}; {used}")
    return out


def single_place(setup: DiagnosisProblem) -> list[str]:
    """A sentence where all poses look at one place."""
    if not setup.context.scanner_on_flange or len(np.unique(setup.linear.obs.station)) > 1:
        return []
    return ["all poses look at one place: held-out figures are of that place, and it is not shown that the model holds at other places"]


def not_carried_over(verdict: str, validation: CrossValidation, effects: Sequence[EffectFound] = ()) -> list[str]:
    """A sentence where a recording is explained and yet what is learnt from a part of it does not predict the rest down to noise."""
    left_out = validation.after
    if verdict != "explained":
        return []
    moved = [at for e in effects for at in e.where if at.startswith("station")]
    if moved and validation.split == "station" and left_out.chi2_dof > 1 + K * np.sqrt(2 / max(left_out.dof, 1)):
        each = ", ".join(moved)
        return [
            f"what happens at {each} alone is not known where the whole station is left out: it stays in the figures of held-out data, "
            "and these do not judge it"
        ]
    if left_out.chi2_dof <= OPTIONS.noticeable:
        return []
    part = "a place" if validation.split == "station" else "a part of the poses"
    return [
        f"errors at {part} that is left out have {left_out.chi2_dof:.1f} times the variance that noise and fit allow: the effects "
        f"explain the poses that were measured, and may not hold at others"
    ]


def sum_of_shares(mismatch: Sequence[MismatchEntry], before: PredictiveScore, after: PredictiveScore) -> list[str]:
    """A sentence where the shares do not add up to 100 %.

    The share of a place is what only this place explains: what several explain alike is in no share, and places that compensate each other
    have more than they explain together. before, after: scores on the data of the fit, with geometry alone and with everything found.
    """
    if not mismatch:
        return []
    total = sum(m.share for m in mismatch)
    explained = min(max((before.chi2 - after.chi2) / max(before.chi2 - before.dof, 1e-9), 0.0), 1.0)
    said = []
    if explained > total + UNSAID:
        said.append(f"several locations explain another {explained - total:.0%} alike")
    elif total > explained + UNSAID:
        said.append(f"together they explain {explained:.0%}, because some compensate others" if explained > UNSAID else "none is confirmed")
    if explained < 1 - UNSAID:
        said.append(f"{1 - (explained if said else total):.0%} is not explained")  # of figures that are rounded alike
    return [f"the shares add up to {total:.0%}: {', '.join(said)}"] if said else []


def partial_periods(setup: DiagnosisProblem, full: ModelFit) -> list[str]:
    """Sentences on periodic errors of which the recording covers less than a period."""
    out = []
    for m in full.model.members:
        candidate, hyper = m.candidate, m.hyper
        for name in partly_covered(setup.context, candidate, hyper):
            values = setup.context.value(name)
            share = periods_covered(values, hyper or 0.0)
            low, high = in_degrees([values.min(), values.max()])
            out.append(
                f"{candidate.name} at {candidate.where[0]}, order {hyper:.3g}: the poses cover {share:.2f} of its period; it is a "
                f"smooth function of {name} from {low:.0f} to {high:.0f}°, and is not shown to repeat beyond"
            )
    return out


def unfinished_warm_ups(setup: DiagnosisProblem, effects: Sequence[EffectFound]) -> list[str]:
    """Sentences on what fades with time so slowly that the recording shows only how it begins."""
    out = []
    names = {c.hyper.name for c in setup.candidates if c.hyper is not None and c.hyper.kind == FADING}
    for effect in effects:
        constants = [p for name, p in effect.parameters.items() if name.rpartition(".")[2] in names]
        if any(np.max(p.std) > 0.5 * np.ptp(setup.context.time) for p in constants):
            out.append(
                f"{effect.name} at {effect.where[0]}: the recording is too short for its time constant, so both are uncertain together; "
                f"only the change within the recording was measured"
            )
    return out


def bent_artefacts(obs: Observations, effects: Sequence[EffectFound]) -> list[str]:
    """A sentence for each artefact of which several balls were found elsewhere than certified: that has one cause."""
    moved = [where for e in effects for where in e.where if where.startswith("ball")]
    out = []
    for number, artefact in enumerate(obs.cell.artefacts):
        mine = [f"ball{b}" for b, owner in zip(obs.cell.ball_ids, obs.cell.ball_artefact, strict=True) if owner == number]
        several = [where for where in moved if where in mine]
        if len(several) > 1:
            out.append(
                f"{', '.join(several)} of {artefact.name}: if an artefact bends, sags or has another certificate, several balls are off, "
                "so the shift of a single ball is not certain; have the artefact certified anew as it is mounted"
            )
    return out


def confounded_pauses(obs: Observations, effects: Sequence[EffectFound]) -> list[str]:
    """Sentences on pauses of the recording, where a change in time was found: what happens meanwhile no pose can tell apart."""
    found = [p for e in effects for name, p in e.parameters.items() if name.rpartition(".")[2] == "at_pose"]
    moments = [(float(v), float(s)) for p in found for v, s in zip(np.atleast_1d(p.value), np.atleast_1d(p.std), strict=True)]
    out = []
    for after, pause in pauses(obs):
        rank = {int(n): r for r, n in enumerate(obs.pose_id[obs.measuring_order])}
        near = [m for m, std in moments if abs(rank.get(round(m), np.inf) - rank[after]) <= max(2 * std, 5.0)]
        if near:
            out.append(
                f"there is {pause}: the change at pose {near[0]:.0f} may be a displacement, thermal growth or a new mastering meanwhile: "
                "in these data they cannot be told apart"
            )
        elif any(catalogue.declaration(e.name).acts_in_time for e in effects):
            out.append(f"there is {pause}")
    return out


def pauses(obs: Observations) -> list[tuple[int, str]]:
    """Pauses of a recording: number of the pose after each, and the pause in words with the temperatures that changed across it."""
    if obs.time_s is None:
        return []
    order = obs.measuring_order
    out = []
    for a, b in zip(order[:-1], order[1:], strict=True):
        if (pause := obs.time_s[b] - obs.time_s[a]) > PAUSE_S:
            lasting = f"{pause / 3600:.1f} h" if pause > 5400 else f"{pause / 60:.0f} min"
            degrees = {name: (f"{T[a]:.1f}", f"{T[b]:.1f}") for name, T in obs.temperatures.items()}
            changes = [f"{name} went from {old} to {new} °C" for name, (old, new) in degrees.items() if old != new]
            out.append((int(obs.pose_id[b]), ", ".join([f"a pause of {lasting} after pose {obs.pose_id[a]}", *changes])))
    return out
