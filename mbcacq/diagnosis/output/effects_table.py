"""Effects and places as they are told: names first by what they are worth, then what has no name."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.nonparametric.evidence_map import log10_tail
from mbcacq.diagnosis.output.contributions import Contributions
from mbcacq.diagnosis.result import EffectFound
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore
from mbcacq.effects.pose import payload

ONE_ENTRY = ("A", "link", "station")  # places at which one effect may be several times and is told as one


def named_effects(full: ModelFit, worth: Contributions, proof: CrossValidation) -> list[EffectFound]:
    """Selected effects gathered by name (several joints of one effect make one entry), most important first; a wrong payload before the
    elasticity that every arm has and that shows it.
    """
    model = full.model
    grouped: dict[str, list[int]] = {}
    for j, (candidate, _) in enumerate(model.effects):
        name = candidate.name
        several = candidate.where[0].startswith(ONE_ENTRY) and name != "wrist_coupling"
        grouped.setdefault(name if several else f"{name}:{'+'.join(candidate.where)}", []).append(j)
    out = []
    for members in grouped.values():
        first = model.effects[members[0]][0]
        gain = worth.of(members)
        where = list(dict.fromkeys(w for j in members for w in model.effects[j][0].where))
        p_value = 10 ** max(log10_tail(gain, sum(model.effects[j][0].k for j in members)), -300.0)
        effect = EffectFound(first.name, where, first.depends_on, merge_parameters(full, members), p_value, proof.gain(first.name))
        out.append((first.name == payload.NAME, gain, effect))
    return [effect for *_, effect in sorted(out, key=lambda item: (-item[0], -item[1]))]


def merge_parameters(full: ModelFit, members: list[int]) -> dict:
    """Parameters of all members; the same name twice (several orders at one joint) makes lists."""
    out: dict[str, dict] = {}
    parts = full.model.slices()
    for j in members:
        candidate, hyper = full.model.effects[j]
        p = parts[j]
        for name, entry in candidate.report(full.model.coefficients[p], full.model.covariance[p, p], hyper).items():
            if name not in out:
                out[name] = dict(entry)
            else:
                for field in ("value", "std"):
                    old = out[name][field] if isinstance(out[name][field], list) else [out[name][field]]
                    out[name][field] = [*old, *(entry[field] if isinstance(entry[field], list) else [entry[field]])]
    return out


def unknown_effects(full: ModelFit, worth: Contributions, proof: CrossValidation) -> list[EffectFound]:
    """One entry for each place that moves in a way without a name, largest first; for a long recording, where it stands at all places,
    one entry at the place that the map points to.
    """
    if full.smooth is None:
        return []
    size = sizes(full)
    ranked = sorted(size, key=lambda key: -size[key][0])
    if not full.cells:
        modelled = {at for at, _ in size}
        first = next((c for c in full.residual_tests.significant_cells if c.location in modelled), None) if full.residual_tests else None
        at, on = (first.location, first.depends_on) if first else ranked[0]
        p_value = float(np.exp(-first.log_bayes_factor)) if first and first.log_bayes_factor < 690 else 0.0
        return [EffectFound("unknown", [at], on, in_words(size, ranked[:12]), min(p_value, 1.0), proof.unmodelled_gain)]
    out = []
    for at in dict.fromkeys(at for at, _ in ranked):
        mine = [key for key in ranked if key[0] == at]
        evidence = max((c.log_bayes_factor for c in full.cells if c.location == at), default=0.0)
        p_value = float(np.exp(-np.clip(evidence, 0, 690)))
        effect = EffectFound("unknown", [at], mine[0][1], in_words(size, mine), p_value, proof.gain(f"unknown:{at}"))
        out.append((worth.of(worth.groups_at(full, at)), effect))
    return [effect for _, effect in sorted(out, key=lambda item: -item[0])]


def where_it_is(places: list[dict]) -> list[EffectFound]:
    """What is there and could not be modelled, at the most suspicious place: it has explained nothing yet."""
    return [EffectFound("unknown", [place["at"]], place["depends_on"], {}, place["p_value"], 0.0) for place in places[:1]]


def sizes(full: ModelFit) -> dict[tuple[str, str], tuple[float, float]]:
    """(place, covariate) -> by how many mm rms its groups move the centres, and the standard deviation of that."""
    smooth, keep = full.smooth, full.geometry_only.linear.keep
    X = full.conditioned.whiten(smooth.columns) * smooth.sigma
    taken = full.conditioned.all_projected.T @ X
    covariance = np.linalg.inv(X.T @ X - taken.T @ taken + np.eye(X.shape[1])) * np.outer(smooth.sigma, smooth.sigma)
    square: dict[tuple[str, str], float] = {}
    slope: dict[tuple[str, str], np.ndarray] = {}
    for g, p in zip(smooth.groups, smooth.slices(), strict=True):
        moved, key = (g.columns[keep] @ smooth.coefficients[p])[:, :3], (g.location, g.depends_on)
        square[key] = square.get(key, 0.0) + float(np.mean(np.sum(moved**2, axis=1)))
        mine = slope.setdefault(key, np.zeros(X.shape[1]))
        mine[p] = np.einsum("mrk,mr->k", g.columns[keep][:, :3], moved) / len(moved)
    out = {}
    for key, value in square.items():
        rms = float(np.sqrt(value))
        out[key] = rms, float(np.sqrt(slope[key] @ covariance @ slope[key])) / max(rms, 1e-12)
    return out


def in_words(size: dict[tuple[str, str], tuple[float, float]], keys: list[tuple[str, str]]) -> dict:
    return {f"{at}({on}).rms_mm": {"value": size[at, on][0], "std": size[at, on][1]} for at, on in keys}


def mismatch_list(full: ModelFit, worth: Contributions, before: PredictiveScore, anything: bool = False) -> list[dict]:
    """Where simulation and recording part, each place and covariate with its share of the excess, largest first.

    anything: the most suspicious place even where none is significant.
    """
    excess = max(before.chi2 - before.dof, full.model.gain, 1e-9)
    found: dict[tuple[str, str], dict] = {}

    def add(at: str, on: str, gain: float, p_value: float) -> None:
        entry = {"at": at, "depends_on": on, "share": float(np.clip(gain / excess, 0, 1)), "p_value": float(np.clip(p_value, 1e-300, 1.0))}
        if (at, on) not in found or found[at, on]["share"] < entry["share"]:
            found[at, on] = entry

    together: dict[tuple[str, str], list[int]] = {}  # several orders at one joint are one place
    for j, (candidate, _) in enumerate(full.model.effects):
        together.setdefault((candidate.where[-1], candidate.depends_on), []).append(j)
    for (at, on), members in together.items():
        gain = worth.of(members)
        add(at, on, gain, 10 ** max(log10_tail(gain, sum(full.model.effects[j][0].k for j in members)), -300.0))
    for cell in full.cells:
        gain = worth.of(worth.groups_at(full, cell.location, cell.depends_on))
        add(cell.location, cell.depends_on, gain, float(np.exp(-np.clip(cell.log_bayes_factor, 0, 690))))
    if not full.cells and full.residual_tests is not None and (full.residual_tests.structure or anything):
        # Neighbouring places explain each other's mismatch: the most significant one carries the largest share.
        spots = full.residual_tests.significant_cells[:6]
        scale = full.geometry_only.linear.keep.sum() / max(full.residual_tests.centres, 1)
        gains = sorted((scale * (c.gain - c.used) for c in spots), reverse=True)
        for c, gain in zip(spots, gains, strict=True):
            add(c.location, c.depends_on, gain, float(np.exp(-np.clip(c.log_bayes_factor, 0, 690))))
    return sorted(found.values(), key=lambda e: -e["share"])
