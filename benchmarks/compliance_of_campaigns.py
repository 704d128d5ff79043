"""The compliance of the UR10's joints in two campaigns, and how much of a difference is the model's.

    python benchmarks/compliance_of_campaigns.py [--data ../shared/data] [--poses 1500]

Each campaign is linearised at its geometry, with the noise that is left beside all groups; the compliances are fitted with the geometry,
then with each joint's own errors, then with links and base that tilt under the weight behind them. Standard deviations are scaled by the
misfit.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from transfer import learnt, some

import mbcacq
from mbcacq.calibration.with_effects import own_joint
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm, LearntRecording
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.parameters import Estimate, build
from mbcacq.estimation.solver import system
from mbcacq.model.observations import Observations

FEW = 600  # poses that tell the noise
OWN_SIZE = 0.12  # of the prior of a joint's own error: what marginal likelihood gives, 0.10 to 0.16 for all joints but A6 of series A


def kind(t: EffectTerm) -> str:
    """'own' error of a joint, 'compliance' of a joint, or 'tilt' of a link or the base."""
    return "own" if own_joint(t) is not None and t.k > 1 else "compliance" if t.where[0][0] == "A" else "tilt"


def compliances(obs: Observations, poses: int) -> list[str]:
    """One row for each model: A2 and A3, urad/Nm."""
    options = mbcacq.CalibrationOptions(refuse=False)
    noise = learnt(some(obs, FEW))[0].noise
    obs = some(obs, poses)
    alone = mbcacq.calibrate(obs, options)
    terms = tuple(unmodelled.everywhere(Covariates(obs)))
    model = EffectModel(obs.cell.robot, terms, LearntRecording.of(obs), obs.cell.measurement)
    asked = replace(options, terms=model.at(obs))
    layout = build(obs, asked)
    for name, why in alone.held.items():
        layout = layout if name in layout.held else layout.hold(name, why)
    start = Estimate(alone.state, tuple(np.zeros(t.k) for t in terms))
    at = system(Lineariser(obs, layout, asked), start, noise, alone.weights)
    information = at.normal.information - np.diag(layout.gather("sigma") ** -2.0)
    of = {name: (kind(t), sigma) for t in terms for name, sigma in zip(t.names, t.sigma, strict=True)}
    rows = []
    for wanted in (("compliance",), ("compliance", "own"), ("compliance", "own", "tilt")):
        scale = layout.gather("scale").copy()
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
        found = [names.index(f"unknown:A{i}:gravity_torque_{i}[0]") for i in (2, 3)]
        each = "; ".join(f"A{i} {1e6 * value[j]:.1f} +- {1e6 * std[j]:.1f}" for i, j in zip((2, 3), found, strict=True))
        rows.append(f"{' + '.join(wanted)}: {each} (chi {misfit:.2f})")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--poses", type=int, default=1500)
    given = parser.parse_args()
    for name in "ac":
        print(
            f"series {name.upper()}, urad/Nm",
            *compliances(mbcacq.load_observations(given.data / f"ur10-tracker-{name}"), given.poses),
            sep="\n  ",
        )


if __name__ == "__main__":
    main()
