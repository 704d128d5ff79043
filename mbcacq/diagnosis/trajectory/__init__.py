"""Diagnosis of recordings in time: joint-side against motor-side angle, set point against actual, torque against rigid body."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.trajectory.left import structure
from mbcacq.diagnosis.trajectory.runs import channels, prepare
from mbcacq.diagnosis.trajectory.select import Explained, with_load
from mbcacq.diagnosis.trajectory.shared import Shared, explain_group
from mbcacq.errors import ConfigError


def diagnose_trajectories(trajectories: list) -> dict:
    """One mbcacq-diagnosis/1 object for one or several recordings of one robot. Raises ConfigError where they do not fit together.

    ``fit`` carries, beside the chi2 per degree of freedom over all channels, one entry a channel in that channel's own unit.
    """
    if not trajectories:
        raise ConfigError("no trajectory was given")
    if len({t.robot.n for t in trajectories}) > 1:
        raise ConfigError("the trajectories belong to robots with different numbers of axes; diagnose them separately")
    prepared = [prepare(t) for t in trajectories]
    runs = _common([run for run, _ in prepared])
    every = channels(list(runs), [columns for _, columns in prepared])
    if not every:
        raise ConfigError("nothing to compare: the trajectory needs q*_joint_deg, q*_set_deg, tau*_Nm or motor_tau*_Nm beside q*_deg")
    explained: list[Explained] = []
    shared: list[Shared] = []
    for name in ("tau", "q_joint", "q_set"):  # torque first: the load it tells winds up the gears
        common, each = explain_group([c for c in every if c.name == name], runs)
        explained += each
        shared += [common] if common else []
        if name == "tau" and each:
            runs = with_load(runs, each)
    return _result(explained, shared, runs)


def _common(runs: list) -> tuple:
    """Keep only the signals that every run has."""
    from dataclasses import replace

    missing = {name: None for name in ("q_set", "q_joint", "torque", "rigid", "gravity") if any(getattr(r, name) is None for r in runs)}
    return tuple(replace(r, **missing) for r in runs)


def _result(explained: list[Explained], shared: list[Shared], runs: tuple) -> dict:
    effects = [{"name": s.candidate.name, "where": list(s.candidate.where), "depends_on": "qd",
                "parameters": {"latency_s": {"value": s.value, "std": s.std}}, "p_value": s.p_value, "held_out_gain": s.gain,
                "alternatives": []} for s in shared]
    mismatch, fits, floors = [], [], []
    for e in explained:
        channel = e.channel
        for taken, parameters in zip(e.taken, e.parameters, strict=True):
            effects.append({"name": taken.candidate.name, "where": list(taken.candidate.where), "channel": channel.name,
                            "parameters": parameters, "p_value": taken.p_value, "held_out_gain": taken.gain, "alternatives": []})
            mismatch.append({"at": channel.axis, "channel": channel.name, "depends_on": taken.candidate.depends_on,
                             "share": taken.gain, "p_value": taken.p_value})
        floor = _floor(e)
        floors.append(floor)
        fits.append(_channel_fit(e, floor))
        for found in structure(e, runs, floor):
            if found["kind"] == "smooth":
                effects.append(found["effect"])
            mismatch.append(found["mismatch"])
    for s in shared:
        mismatch.append({"at": s.candidate.where[0], "depends_on": "qd", "share": s.gain, "p_value": s.p_value})
    mismatch.sort(key=lambda m: -m["share"])
    named = [e for e in effects if e["name"] != "unknown"]
    left = any(f["held_out"]["after_chi2_dof"] > 2.0 for f in fits)
    there = any(f["held_out"]["before_chi2_dof"] > 2.0 for f in fits)
    verdict = "explained" if named and not left else "partly_explained" if named else "unexplained" if there else "none"
    train = {k: float(np.mean([f["train"][k] for f in fits])) for k in ("before_chi2_dof", "after_chi2_dof")}
    test = {k: float(np.mean([f["held_out"][k] for f in fits])) for k in ("before_chi2_dof", "after_chi2_dof")}
    return {
        "format": "mbcacq-diagnosis/1", "verdict": verdict, "mismatch": mismatch,
        "effects": sorted(effects, key=lambda e: -e["held_out_gain"]),
        "fit": {"train": train, "held_out": test | {"split": explained[0].split}, "channels": fits},
        "not_separable": [], "advice": [],
    }


def _floor(e: Explained) -> float:
    """Standard deviation of what no physics of an arm can follow: third differences of the mismatch, as white noise."""
    third = np.concatenate([np.diff(a, 3) for a in e.before])
    return max(float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)), 1e-12)


def _channel_fit(e: Explained, floor: float) -> dict:
    def mean_square(parts):
        return float(np.mean(np.concatenate(parts) ** 2))

    unit, scale = ("deg", float(np.degrees(1))) if e.channel.unit == "rad" else ("N m", 1.0)
    before, after = mean_square(e.before), mean_square(e.after)

    def entry(first, second):
        return {"before_rms": scale * float(np.sqrt(first)), "after_rms": scale * float(np.sqrt(second)),
                "before_chi2_dof": first / floor**2, "after_chi2_dof": second / floor**2}

    return {"channel": e.channel.name, "at": e.channel.axis, "unit": unit, "noise_floor": scale * floor,
            "train": entry(before, after), "held_out": entry(e.held_out_before, e.held_out_after)}
