"""A set in which one ball of an artefact was measured."""

from dataclasses import replace

import simulated

from mbcacq.diagnosis.nonparametric.basis_functions import Basis
from mbcacq.diagnosis.nonparametric.design_blocks import of_scanner
from mbcacq.effects.context import Context
from mbcacq.estimation import forward_model


def test_the_shift_of_the_only_ball_is_no_block_of_its_own(plan):
    state = simulated.nominal_state(plan)
    mine = plan.ball == plan.ball[0]
    obs = replace(plan, pose=plan.pose[mine], ball=plan.ball[mine], xyz=plan.xyz[mine])
    groups = of_scanner(Basis.of(Context(obs, state, forward_model.predict(obs, state)), per_pose=False))
    assert groups
    assert all(group.functions.shape[1] for group in groups)
    assert {block.at for group in groups for block in group.blocks} == {"scanner"}
