"""Poses and motion are diagnosed together only where both are of one arm, whatever their files call it."""

from dataclasses import replace

import pytest
from test_diagnose_trajectories import ARM

from mbcacq.errors import ConfigError
from mbcacq.workflow.diagnose_recordings import refuse_motion_of_other_arm


def test_another_name_is_no_other_arm():
    refuse_motion_of_other_arm(ARM, replace(ARM, name="the same arm as its controller calls it"))


def test_motion_of_an_arm_with_other_links_is_refused_by_name():
    longer = ARM.chain.rows.copy()
    longer[1, 2] += 30.0  # mm
    other = replace(ARM, name="a longer arm", chain=ARM.chain.with_errors(longer - ARM.chain.rows))

    with pytest.raises(ConfigError, match="and the motion is of 'a longer arm'"):
        refuse_motion_of_other_arm(ARM, other)
