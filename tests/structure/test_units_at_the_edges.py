"""Angles are rad inside: one module turns them to and from degrees, for what people and files say and are told."""

import ast

from parsed import ROOT, nodes

PACKAGE = ROOT / "mbcacq"
CONVERSIONS = {"degrees", "radians", "deg2rad", "rad2deg"}
EDGES = {
    "quantities.py",  # the module itself
    "files/angles.py",  # decimals in files, without a lost bit
}
# Files that still convert by themselves. The list only becomes shorter.
STILL = {
    "calibration/change_found.py",
    "calibration/compare_methods.py",
    "calibration/description_hypotheses.py",
    "calibration/hand_eye_equations.py",
    "calibration/staged/stages.py",
    "calibration/sufficiency.py",
    "diagnosis/motion/assemble.py",
    "diagnosis/motion/description_check.py",
    "diagnosis/noise_dependence.py",
    "diagnosis/output/next_measurements.py",
    "diagnosis/output/notes.py",
    "diagnosis/output/orders.py",
    "diagnosis/output/pictures.py",
    "diagnosis/output/text.py",
    "effects/common_pattern.py",
    "effects/covariates.py",
    "effects/discrepancy.py",
    "effects/kinds/backlash.py",
    "effects/kinds/gear_transmission_error.py",
    "effects/kinds/gravity_compensator.py",
    "effects/kinds/hysteresis.py",
    "effects/kinds/joint_settling.py",
    "effects/kinds/joint_step.py",
    "effects/kinds/lost_motion.py",
    "effects/kinds/mount_clearance.py",
    "effects/kinds/mount_shift.py",
    "effects/learnt_range.py",
    "effects/motion_effect.py",
    "effects/motion_periods.py",
    "effects/unmodelled.py",
    "effects/untried.py",
}


def test_only_the_edges_turn_radians_to_degrees():
    found = set()
    for path, node in nodes(ast.Attribute):
        library = isinstance(node.value, ast.Name) and node.value.id in ("np", "math", "numpy")
        if library and node.attr in CONVERSIONS and path.is_relative_to(PACKAGE):
            found.add(path.relative_to(PACKAGE).as_posix())
    assert found - EDGES <= STILL
