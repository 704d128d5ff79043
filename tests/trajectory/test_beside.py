"""Poses and motion of one run: what both told must agree in size, and it is said when it does not."""

from mbcacq.diagnosis.motion.combine import agreement


def told(value, std):
    return {
        "effects": [{"name": "joint_compliance", "where": ["A2"], "parameters": {"A2.compliance_rad_per_Nm": {"value": value, "std": std}}}]
    }


def test_two_measurements_of_one_compliance():
    found = agreement(told(4.0e-6, 1e-7), told(4.2e-6, 1e-7))
    assert [(a["parameter"], a["agrees"]) for a in found] == [("A2.compliance_rad_per_Nm", True)]
    assert abs(found[0]["sigmas"] - 1.414) < 1e-3
    assert not agreement(told(4.0e-6, 1e-8), told(4.2e-6, 1e-8))[0]["agrees"]
    assert agreement(told(4.0e-6, 1e-8), {"effects": []}) == []
