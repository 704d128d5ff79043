"""How strong a injected effect must be for a wanted excess over the noise, once geometry and stations have absorbed what they can."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import Injected, observe
from mbcacq.design.simulated_observations import planned_state
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.catalogue import declaration
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.plan import LoadedPlan, PlannedPose

LARGEST_STRENGTH = 30.0  # times its plain size: beyond this an effect that the plan cannot see stays weak
TRUE_JOINT = 5e-6  # rad, the fake cell's default


@dataclass(frozen=True)
class Gauge:
    """How visible effects are by one plan; the cell is linearised once, where the plan has it."""

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]

    @cached_property
    def screen(self) -> CandidateScoring:
        quiet = Scenario(0, "none", 1, (), 1, 0.0)
        observations, _ = observe(self.loaded, self.poses, quiet, [])
        urad = self.loaded.plan.fake.get("repeatability_urad")
        joint = TRUE_JOINT if urad is None else 1e-6 * float(urad)
        point = np.array(self.loaded.plan.scanner.noise_mm or (0.005, 0.005, 0.009)) / np.sqrt(self.poses[0].exposures)
        return CandidateScoring.of(
            LinearProblem.of(observations, planned_state(self.loaded)), Noise(point, np.full(self.loaded.cell.robot.n, joint))
        )

    def gain(self, scenario: Scenario, injected: Injected) -> float:
        """chi2 that the injected effects add beyond what geometry absorbs, against the same effects at strength nought."""
        plain = replace(scenario, outliers=0.0, missing=())
        with_it, _ = observe(self.loaded, self.poses, plain, injected)
        without_it, _ = observe(self.loaded, self.poses, plain, [{**one, "strength": 0.0} for one in injected])
        moved = self.screen.whiten(with_it.xyz - without_it.xyz)
        taken = self.screen.Q.T @ moved
        return float(moved @ moved - taken @ taken)

    def inject(self, scenario: Scenario) -> Injected:
        """The effects of an scenario, each as strong as is wanted, as a plan's ``fake: hidden`` takes them."""
        out = []
        for i, name in enumerate(scenario.names):
            challenge = declaration(name).challenge
            one = {"name": name, "strength": 1.0, "seed": scenario.effect_seed + i, **(challenge.options if challenge else {})}
            gain = max(self.gain(scenario, [one]), 1e-9)
            most = (challenge.strongest if challenge else None) or LARGEST_STRENGTH
            wanted = scenario.excess * self.screen.dof
            out.append({**one, "strength": float(min(np.sqrt(wanted / gain), most))})
        return out
