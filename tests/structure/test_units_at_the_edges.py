"""Angles are rad inside: one module turns them to and from degrees, as people and files write and read them."""

import ast

from parsed import ROOT, nodes

PACKAGE = ROOT / "mbcacq"
CONVERSIONS = {"degrees", "radians", "deg2rad", "rad2deg"}
EDGES = {
    "quantities.py",  # the module itself
    "files/angles.py",  # decimals in files, without a lost bit
}


def test_only_the_edges_turn_radians_to_degrees():
    found = set()
    for path, node in nodes(ast.Attribute):
        library = isinstance(node.value, ast.Name) and node.value.id in ("np", "math", "numpy")
        if library and node.attr in CONVERSIONS and path.is_relative_to(PACKAGE):
            found.add(path.relative_to(PACKAGE).as_posix())
    assert found <= EDGES
