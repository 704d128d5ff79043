"""``diagnose``: observations in, verdict out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis import advice, covariates, prove, residual_test
from mbcacq.diagnosis.explain import NOTHING, Search
from mbcacq.diagnosis.figures import Evidence
from mbcacq.diagnosis.finding import Finding, Setup, find, prepare, thin
from mbcacq.diagnosis.locate import log10_tail, mismatch
from mbcacq.diagnosis.result import Diagnosis, EffectFound
from mbcacq.diagnosis.smooth import MANY_POSES
from mbcacq.errors import CalibrationError
from mbcacq.observations import Observations
from mbcacq.physics.effect import Candidate

MOST_POSES = 4000
FEWEST_POSES = 12
VISIBLE = 12.0  # chi2 that an effect of typical size must make to be called visible
UNDECIDED = 6.0  # chi2 by which an alternative may be worse and still not be excluded


def diagnose(obs: Observations, folds: int | None = None, progress=lambda text: None) -> Diagnosis:
    """Locate, explain, prove. Raises CalibrationError where the data do not even determine the geometry."""
    if obs.n_poses < FEWEST_POSES:
        raise CalibrationError(f"{obs.n_poses} poses are too few for a diagnosis: measure at least {FEWEST_POSES}")
    try:
        return _diagnose(obs, folds, progress)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the recording does not determine the cell ({error}): measure more stations and orientations") from error


def _diagnose(obs: Observations, folds: int | None, progress) -> Diagnosis:
    progress("fitting the geometry")
    setup = prepare(obs)
    extra = []
    if obs.n_poses > MOST_POSES:
        setup = thin(setup, setup.linear.keep, MOST_POSES)
        extra = [f"of {obs.n_poses} poses {MOST_POSES}, evenly at random, were used"]
    progress("searching for effects")
    full = find(setup)
    progress("proving on data left out")
    proof = prove.prove(setup, full, folds or (4 if obs.n_poses < MANY_POSES else 3 if obs.n_poses < 2000 else 2))
    result = conclude(setup, full, proof)
    result.notes += extra
    return result


def conclude(setup: Setup, full: Finding, proof: prove.Proof) -> Diagnosis:
    model, leftover = full.model, full.leftover
    before, left_before = prove.on_train(full.before, NOTHING, None)
    after, left_after = prove.on_train(full.before, model, full.smooth)
    effects = named_effects(setup, full, before)
    verdict, places = verdict_of(full), mismatch_list(setup, full, before)
    if verdict == "explained" and proof.after.chi2 >= proof.before.chi2:
        # A name that predicts nothing better on data that took no part is not told.
        verdict, effects, places, after = "none", [], [], before
        proof = replace(proof, after=proof.before)
    if full.smooth is not None:
        effects += unknown_effects(full, proof)
    alternatives, inseparable, pairs = rivals(setup, full) if effects else ({}, [], [])
    for effect in effects:
        effect.alternatives = alternatives.get(effect.name, [])
    hints = advice.separate(setup.situation, pairs)
    if verdict == "explained" and inseparable:
        verdict = "cannot_tell"
    if verdict == "none":
        for candidate, seen in unseen(setup, full):
            verdict = "cannot_tell"
            inseparable.append(
                {
                    "effects": [f"{candidate.name}:{'+'.join(candidate.where)}", "geometry and station poses"],
                    "correlation": float(np.sqrt(1 - seen)),
                }
            )
            hints.append(advice.show(setup.situation, candidate))
    floor = float(np.sqrt(after.rms**2))
    fit = {
        "train": {
            "before_rms_mm": before.rms,
            "after_rms_mm": after.rms,
            "before_chi2_dof": before.chi2_dof,
            "after_chi2_dof": after.chi2_dof,
        },
        "held_out": {
            "before_rms_mm": proof.before.rms,
            "after_rms_mm": proof.after.rms,
            "before_chi2_dof": proof.before.chi2_dof,
            "after_chi2_dof": proof.after.chi2_dof,
            "split": proof.split,
        },
        "repeatability_floor_mm": expected_rms(full, floor),
    }
    shown = evidence_of(setup, full, left_before, left_after)
    return Diagnosis(
        verdict, places, effects, fit, inseparable, hints, setup.dropped, notes(setup, full, leftover), shown
    )


def expected_rms(full: Finding, fallback: float) -> float:
    """3D rms (mm) that the estimated noise alone makes at one centre."""
    linear, noise = full.before.linear, full.noise
    joint = np.sum((linear.joint[:, :3] * noise.joint) ** 2, axis=(1, 2))
    return float(np.sqrt(np.mean(joint[linear.keep]) + np.sum(noise.point**2))) if linear.keep.any() else fallback


def verdict_of(full: Finding) -> str:
    structure = full.leftover is not None and full.leftover.structure
    if not full.model.members:
        return "unexplained" if structure else "none"
    if not structure:
        return "explained"
    left = full.leftover.spots[0]
    rest = max(left.gain - left.k, 0.0)
    return "partly_explained" if full.model.gain > rest else "unexplained"


def named_effects(setup: Setup, full: Finding, before: prove.Quality) -> list[EffectFound]:
    """Members gathered by name (several joints of one effect make one entry), most important first."""
    model, search = full.model, Search(setup.candidates)
    excess = max(before.chi2 - before.dof, 1e-9)
    grouped: dict[str, list[int]] = {}
    for j, (candidate, _) in enumerate(model.members):
        name = candidate.name
        key = (
            name
            if candidate.where[0].startswith(("A", "link", "station")) and name != "wrist_coupling"
            else f"{name}:{'+'.join(candidate.where)}"
        )
        grouped.setdefault(key, []).append(j)
    out = []
    for members in grouped.values():
        first = model.members[members[0]][0]
        rest = search.solve(full.before, tuple(m for j, m in enumerate(model.members) if j not in members), permit=True)
        gain = model.gain - rest.gain
        k = sum(model.members[j][0].k for j in members)
        where = list(dict.fromkeys(w for j in members for w in model.members[j][0].where))
        out.append(
            (
                gain,
                EffectFound(
                    first.name,
                    where,
                    first.depends_on,
                    merge_parameters(full, members),
                    10 ** max(log10_tail(gain, k), -300.0),
                    float(np.clip(gain / excess, 0, 1)),
                ),
            )
        )
    return [effect for _, effect in sorted(out, key=lambda pair: -pair[0])]


def merge_parameters(full: Finding, members: list[int]) -> dict:
    """Parameters of all members; the same name twice (several orders at one joint) makes lists."""
    out: dict[str, dict] = {}
    parts = full.model.parts()
    for j in members:
        candidate, hyper = full.model.members[j]
        p = parts[j]
        for name, entry in candidate.report(full.model.coefficients[p], full.model.covariance[p, p], hyper).items():
            if name not in out:
                out[name] = dict(entry)
            else:
                for field in ("value", "std"):
                    old = out[name][field] if isinstance(out[name][field], list) else [out[name][field]]
                    out[name][field] = [*old, *(entry[field] if isinstance(entry[field], list) else [entry[field]])]
    return out


def unknown_effects(full: Finding, proof: prove.Proof) -> list[EffectFound]:
    smooth, keep = full.smooth, full.before.linear.keep
    size: dict[tuple[str, str], float] = {}
    for g, p in zip(smooth.groups, smooth.parts(), strict=True):
        moved = (g.columns[keep] @ smooth.coefficients[p])[:, :3]
        size[g.at, g.depends_on] = size.get((g.at, g.depends_on), 0.0) + float(np.mean(np.sum(moved**2, axis=1)))
    ranked = sorted(size, key=lambda key: -size[key])
    spots = full.leftover.spots if full.leftover else []
    first = next(((p.at, p.depends_on) for p in spots), ranked[0])
    excess = max(proof.before.chi2 - proof.before.dof, 1e-9)
    p_value = 10 ** max(spots[0].log10_p, -300.0) if spots else 1.0
    return [
        EffectFound(
            "unknown",
            [first[0]],
            first[1],
            {f"{at}({on}).rms_mm": {"value": float(np.sqrt(size[at, on])), "std": 0.0} for at, on in ranked[:12]},
            p_value,
            float(np.clip((proof.before.chi2 - proof.after.chi2) / excess, 0, 1)),
        )
    ]


def unseen(setup: Setup, full: Finding) -> list[tuple[Candidate, float]]:
    """Elastic main joints that would not show at their typical size, with the share of their effect that geometry leaves."""
    out = []
    if not setup.situation.masses_known:
        return out
    elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
    strongest = sorted(elastic, key=lambda c: -np.ptp(setup.situation.gravity_torque[:, int(c.where[0][1:]) - 1]))[:1]
    for candidate in strongest:
        scored = full.before.test(candidate)
        if candidate.typical[0] ** 2 / max(scored.covariance[0, 0], 1e-300) < VISIBLE:
            X = full.before.block(candidate, None)
            out.append((candidate, float(np.clip(1 / max(scored.covariance[0, 0], 1e-300) / np.sum(X * X), 0, 1))))
    return out


def rivals(setup: Setup, full: Finding) -> tuple[dict[str, list[dict]], list[dict], list]:
    """For each named effect: what else could stand in its place; the pairs that these data cannot tell apart, in words and as found."""
    alternatives: dict[str, list[dict]] = {}
    inseparable: list[dict] = []
    pairs: list = []
    model = full.model
    if not model.members or len(model.members) > 6:
        return alternatives, inseparable, pairs
    search = Search(setup.candidates)
    excess = max(full.before.chi2 - full.before.dof, 1e-9)
    for name in model.names:
        mine = [j for j, (c, _) in enumerate(model.members) if c.name == name]
        rest = search.solve(full.before, tuple(m for j, m in enumerate(model.members) if j not in mine))
        if rest is None:
            continue
        lost = model.gain - rest.gain
        seen = set()
        for scored in search.expand(full.before, rest):
            candidate = scored.candidate
            if candidate.name == name or candidate.name in seen or len(seen) == 3:
                continue
            seen.add(candidate.name)
            alternatives.setdefault(name, []).append(
                {"name": candidate.name, "where": list(candidate.where), "held_out_gain": float(np.clip(scored.gain / excess, 0, 1))}
            )
            swapped = search.solve(full.before, (*rest.members, (candidate, scored.hyper)))
            if swapped is not None and swapped.score > model.score - UNDECIDED and scored.gain > lost - UNDECIDED:
                inseparable.append(
                    {
                        "effects": [f"{name}:{'+'.join(model.members[mine[0]][0].where)}", f"{candidate.name}:{'+'.join(candidate.where)}"],
                        "correlation": float(np.clip(scored.gain / max(lost, 1e-9), 0, 1)),
                    }
                )
                first, hyper = model.members[mine[0]]
                pairs.append(((first, hyper, model.coefficients[model.parts()[mine[0]]]), (candidate, scored.hyper, scored.coefficients)))
    return alternatives, inseparable, pairs


def mismatch_list(setup: Setup, full: Finding, before: prove.Quality) -> list[dict]:
    """Where simulation and recording part: named effects first, then what is left, each with its share of the excess."""
    model = full.model
    search = Search(setup.candidates)
    excess = max(before.chi2 - before.dof, model.gain, 1e-9)
    out = []
    for j, (candidate, _) in enumerate(model.members):
        rest = search.solve(full.before, model.members[:j] + model.members[j + 1 :], permit=True)
        gain = model.gain - rest.gain
        for at in candidate.where[-1:]:
            out.append(
                {
                    "at": at,
                    "depends_on": candidate.depends_on,
                    "share": float(np.clip(gain / excess, 0, 1)),
                    "p_value": 10 ** max(log10_tail(gain, candidate.k), -300.0),
                }
            )
    merged: dict[tuple[str, str], dict] = {}
    for entry in sorted(out, key=lambda e: -e["share"]):
        merged.setdefault((entry["at"], entry["depends_on"]), entry)
    out = list(merged.values())
    if full.leftover is not None and full.leftover.structure:
        # Neighbouring places explain each other's mismatch, and a place with more components always explains a little more of it: the most
        # significant one comes first and carries the largest share.
        spots = {}
        for spot in sorted(full.leftover.significant, key=lambda p: p.log10_p):
            if spot.at not in spots and len(spots) < 6:
                spots[spot.at] = spot
        shares = sorted((float(np.clip((p.gain - p.k) / excess, 0, 1)) for p in spots.values()), reverse=True)
        out += [
            {"at": p.at, "depends_on": p.depends_on, "share": share, "p_value": 10 ** max(p.log10_p, -300.0)}
            for p, share in zip(spots.values(), shares, strict=True)
        ]
    return sorted(out, key=lambda e: -e["share"])


def notes(setup: Setup, full: Finding, leftover: residual_test.Leftover | None) -> list[str]:
    out = [f"{name} was not considered: {reason}" for name, reason in setup.dropped.items()]
    keep = full.before.linear.keep
    dropped = int(np.sum(~keep))
    if dropped:
        out.append(f"{dropped} of {len(keep)} measured centres are gross outliers and were set aside")
    if not setup.situation.masses_known:
        out.append(
            "no masses given: elasticity under gravity was tested with one kilogram halfway along each link, "
            "its size in rad/Nm is not meaningful"
        )
    return out


def evidence_of(setup: Setup, full: Finding, before: np.ndarray, after: np.ndarray) -> Evidence:
    """What pictures are drawn from; the map itself is made only when it is drawn."""
    s, linear = setup.situation, full.before.linear
    obs, keep = linear.obs, linear.keep
    if s.scanner_on_flange:
        T = linear.prediction.T_base_scanner[obs.pose]
    else:
        T = linear.prediction.T_base_station[obs.pose]
    points = np.einsum("mij,mj->mi", T[:, :3, :3], obs.xyz) + T[:, :3, 3]
    turned = [np.einsum("mij,mj->mi", T[:, :3, :3], r[:, :3])[keep] for r in (before, after)]
    values = {c.name: np.asarray(c.values, float)[obs.pose][keep] for c in covariates.of_poses(s)}
    if s.scanner_on_flange:
        values |= {c.name: np.asarray(c.values, float)[keep] for c in covariates.of_centres(s)}
    return Evidence(lambda: mismatch(full.before, s), points[keep], turned[0], turned[1], values)
