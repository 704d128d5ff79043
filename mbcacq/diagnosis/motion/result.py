"""What was found in all groups as one mbcacq-diagnosis/1 object."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.fit import FoundTerm, MotionFit
from mbcacq.diagnosis.motion.normal_store import third_difference_noise
from mbcacq.diagnosis.motion.residual_structure import structure
from mbcacq.diagnosis.result import FORMAT, plain
from mbcacq.effects.motion.effect import MotionSignals

LEFT = 2.0  # held-out chi2 per degree of freedom above which something is unexplained


def outcome(explained: list[MotionFit], runs: tuple[MotionSignals, ...], proof: dict[str, np.ndarray] | None) -> dict:
    """proof: mean squares (2, J) before and after by kind of mismatch, on parts that took no part in choosing or fitting; None for
    the figures by which effects were chosen."""
    effects, mismatch, fits = [], [], []
    for e in explained:
        floor = noise_floor(e)
        excess = total_excess(e, floor)
        for f in e.found:
            effects.append(_effect(e, f, floor, excess))
        mismatch += _mismatch(e, floor)
        for place in range(len(e.group.joints)):
            shown = np.stack([e.held_start, e.held_end]) if proof is None else proof[e.group.name]
            fits.append(_fit(e, place, floor[place], shown[:, place]))
            # What is left of a joint, as a share of all that was there to explain.
            weight = max(float(e.held_end[place]) / floor[place] ** 2 - 1.0, 0.0) / total_excess(e, floor)
            found = structure(e, place, runs, float(floor[place]), min(weight, 1.0))
            if found is not None:
                mismatch.append(found["mismatch"])
                effects += [found["effect"]] if "effect" in found else []
    mismatch.sort(key=lambda m: -m["share"])
    named = [x for x in effects if x["name"] != "unknown"]
    left = any(f["held_out"]["after_chi2_dof"] > LEFT for f in fits)
    there = any(f["held_out"]["before_chi2_dof"] > LEFT for f in fits)
    verdict = "explained" if named and not left else "partly_explained" if named else "unexplained" if there else "none"
    return plain(
        {
            "format": FORMAT,
            "verdict": verdict,
            "mismatch": mismatch,
            "effects": sorted(effects, key=lambda x: -x["held_out_gain"]),
            "fit": {"train": _mean(fits, "train"), "held_out": _mean(fits, "held_out") | {"split": explained[0].split}, "channels": fits},
            "not_separable": [],
            "advice": [],
        }
    )


def _mean(fits: list[dict], part: str) -> dict[str, float]:
    return {k: float(np.mean([f[part][k] for f in fits])) for k in ("before_chi2_dof", "after_chi2_dof")}


def _effect(e: MotionFit, f: FoundTerm, floor: np.ndarray, excess: float) -> dict:
    at = [e.group.joints.index(j) for j in f.joints]
    here = float(np.maximum(e.held_start[at] / floor[at] ** 2 - 1.0, 0.0).sum())
    drop = float((f.gain / floor**2).sum())
    alternatives = [{"name": r["name"], "where": r["where"], "held_out_gain": r["gain"] * drop / max(excess, 1e-300)} for r in f.rivals]
    return {
        "name": f.name,
        "where": f.where,
        "depends_on": f.depends_on,
        "channel": e.group.name,
        "parameters": f.parameters,
        "p_value": f.p_value,
        "held_out_gain": drop / max(excess, 1e-300),
        "held_out_gain_here": float((f.gain[at] / floor[at] ** 2).sum()) / max(here, 1e-300),
        "alternatives": alternatives,
        "steps": [{"adds": s["adds"], **_in_units(e, s, at)} for s in f.steps],
    }


def _in_units(e: MotionFit, step: dict, at: list[int]) -> dict:
    scale = _scale(e)
    return {f"held_out_{k}_rms": {f"A{e.group.joints[i] + 1}": scale * float(np.sqrt(step[k][i])) for i in at} for k in ("before", "after")}


def _mismatch(e: MotionFit, floor: np.ndarray) -> list[dict]:
    """One entry a named dependence; share: of the held-out excess of this kind of mismatch over the noise."""
    excess = total_excess(e, floor)
    out = []
    for f in e.found:
        place = f.where[0] if len(f.joints) == 1 and f.name != "wrist_coupling" else f.where[-1]
        out.append(
            {
                "at": place,
                "channel": e.group.name,
                "depends_on": f.depends_on,
                "share": float((f.gain / floor**2).sum()) / excess,
                "p_value": f.p_value,
            }
        )
    return out


def total_excess(e: MotionFit, floor: np.ndarray) -> float:
    """Held-out chi2 over the noise, of all joints of a kind of mismatch before any effect."""
    return max(float(np.maximum(e.held_start / floor**2 - 1.0, 0.0).sum()), 1e-300)


def noise_floor(e: MotionFit) -> np.ndarray:
    """(J,) standard deviation of what no physics of an arm can follow."""
    return np.array([third_difference_noise(tuple(m[:, place] for m in e.group.mismatch)) for place in range(len(e.group.joints))])


def _scale(e: MotionFit) -> float:
    return float(np.degrees(1)) if e.group.unit == "rad" else 1.0


def _fit(e: MotionFit, place: int, floor: float, proof: np.ndarray) -> dict:
    scale = _scale(e)

    def entry(before: float, after: float) -> dict:
        return {
            "before_rms": scale * float(np.sqrt(before)),
            "after_rms": scale * float(np.sqrt(after)),
            "before_chi2_dof": float(before / floor**2),
            "after_chi2_dof": float(after / floor**2),
        }

    return {
        "channel": e.group.name,
        "at": f"A{e.group.joints[place] + 1}",
        "unit": "deg" if e.group.unit == "rad" else e.group.unit,
        "noise_floor": scale * float(floor),
        "train": entry(e.train_start[place], e.train_end[place]),
        "held_out": entry(*proof),
    }
