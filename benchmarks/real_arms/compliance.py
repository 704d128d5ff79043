"""Compliances of two days, by what else the model holds."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from bench import ROOT, put, table

import mbcacq
from mbcacq.calibration.with_effects import own_joint
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm, LearntRecording
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.parameters import Estimate, build
from mbcacq.estimation.solution import system
from mbcacq.model.observations import Observations
from real_arms.transfer import learnt, some

FEW = 600  # poses that tell the noise
OWN_SIZE = 0.12  # of the prior of a joint's own error: what marginal likelihood gives, 0.10 to 0.16 for all joints but A6 of series A
MODELS = {
    "compliance alone": ("compliance",),
    "and each joint's own error to order 60": ("compliance", "own"),
    "and what its movement leaves behind": ("compliance", "own", "movement"),
    "and links and base that tilt under the weight behind them": ("compliance", "own", "movement", "tilt"),
}


JOINTS = (2, 3)
PAGE = ROOT / "docs" / "data" / "ur10-tracker.md"
BEGIN, AFTER = "<!-- compliance -->\n", "<!-- end of compliance -->\n"


def kind(t: EffectTerm) -> str:
    """'own' error of a joint, by its 'movement', its 'compliance', or 'tilt' of a link or the base."""
    if t.depends_on.startswith("movement_"):
        return "movement"
    return "own" if own_joint(t) is not None and t.k > 1 else "compliance" if t.where[0][0] == "A" else "tilt"


def compliances(obs: Observations, poses: int) -> list[list[str]]:
    """For each model the compliance of each of JOINTS with its standard deviation, urad/Nm, and the misfit."""
    options = mbcacq.CalibrationOptions(refuse=False, discrepancy=False, random_links=False)  # what the models hold beside it is theirs
    noise = learnt(some(obs, FEW))[0].noise
    obs = some(obs, poses)
    alone = mbcacq.calibrate(obs, options)
    terms = tuple(unmodelled.everywhere(Covariates(obs)))
    model = EffectModel(obs.cell.robot, terms, LearntRecording.of(obs), obs.cell.measurement)
    asked = replace(options, terms=model.at(obs))
    layout = build(obs, asked)
    for name, why in alone.layout.held.items():
        layout = layout if name in layout.held else layout.hold(name, why)
    start = Estimate(alone.state, tuple(np.zeros(t.k) for t in terms))
    at = system(Lineariser(obs, layout, asked), start, noise, alone.fit.weights)
    information = at.normal.information - np.diag(layout.sigma**-2.0)
    of = {name: (kind(t), sigma) for t in terms for name, sigma in zip(t.names, t.sigma, strict=True)}
    rows = []
    for wanted in MODELS.values():
        scale = layout.scale.copy()
        free = np.ones(len(scale), bool)
        weight = np.zeros(len(scale))
        for j, name in enumerate(layout.names):
            if name in of:
                which, sigma = of[name]
                free[j] = which in wanted
                weight[j] = (sigma * (OWN_SIZE if which == "own" else 1.0)) ** -2.0
        S = scale[:, None] * (information + np.diag(weight)) * scale
        inverse = np.linalg.inv(S[np.ix_(free, free)])
        value = inverse @ (scale * at.normal.gradient)[free]
        cost = at.cost - value @ (scale * at.normal.gradient)[free]
        misfit = max(float(np.sqrt(cost / (obs.n_centres * 6))), 1.0)
        value, std = value * scale[free], np.sqrt(np.diag(inverse)) * scale[free] * misfit
        names = [name for name, keep in zip(layout.names, free, strict=True) if keep]
        found = [names.index(f"unknown:A{i}:gravity_torque_{i}[0]") for i in JOINTS]
        rows.append([f"{1e6 * value[j]:.1f} +- {1e6 * std[j]:.1f}" for j in found] + [f"{misfit:.2f}"])
        print(wanted, *rows[-1], flush=True)
    return rows


def compliance(given: argparse.Namespace) -> None:
    """The compliance of the UR10's joints in two campaigns, and how much of a difference is the model's.

    Each campaign is linearised at its geometry, with the noise that is left beside all groups. The compliances are fitted with the
    geometry, and then with further errors. These are each joint's own, those that its movement from the pose before leaves behind, and
    links and base that tilt under the weight behind them. Standard deviations are scaled by the misfit.
    """
    each = [compliances(mbcacq.load_observations(given.data / f"ur10-tracker-{name}"), given.poses) for name in "ac"]
    heads = [f"{what}, series {name}" for name in "AC" for what in (*(f"A{i}" for i in JOINTS), "misfit")]
    rows = [[model, *a, *c] for model, a, c in zip(MODELS, *each, strict=True)]
    lines = "\n".join(table(["model beside the geometry", *heads], rows))
    print(lines)
    if given.write:
        put(PAGE, lines, BEGIN, AFTER)
