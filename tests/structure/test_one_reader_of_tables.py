"""One place reads CSV: what another one forgot to refuse would be a wrong number."""

import ast

from parsed import ROOT, nodes

PACKAGE = ROOT / "mbcacq"
READERS = {"reader", "DictReader", "genfromtxt", "loadtxt", "read_csv"}
ALLOWED = {
    "files/csv_text.py",  # the reader
    "spheres/cloud_file.py",  # points of PLY and PCD as text
    "spheres/cloud_files.py",  # clouds as rows of numbers without headings
}


def test_nothing_else_reads_tables():
    found = set()
    for path, node in nodes(ast.Attribute):
        table = node.attr in READERS and isinstance(node.value, ast.Name) and node.value.id in ("csv", "np", "pd")
        if table and path.is_relative_to(PACKAGE):
            found.add(path.relative_to(PACKAGE).as_posix())
    assert found == ALLOWED
