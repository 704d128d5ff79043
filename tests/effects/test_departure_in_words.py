"""What a recording has beyond the range in which an effect was learnt, in words."""

from mbcacq.effects.effect_model import Departure


def test_a_range_has_its_unit_and_nothing_is_foretold_of_the_effect():
    """A compliance goes on beyond the recorded torques: no less of it is to be expected there."""
    torque = Departure(covariate="gravity_torque_2", share=0.08, low=-390.7, high=522.8, effects=("joint_compliance at A2",))
    assert "here -390.7 to 522.8 N·m: no data support it there" in str(torque)
    angle = Departure(covariate="q4", share=0.08, low=-1.0, high=1.0, effects=("unmodelled effect at A4",))
    assert "here -57.3 to 57.3°: " in str(angle)
