"""One place reads CSV: what another one forgot to refuse would be a wrong number."""

import ast
from pathlib import Path

import mbcacq

ROOT = Path(mbcacq.__file__).parent
READERS = {"reader", "DictReader", "genfromtxt", "loadtxt", "read_csv"}
ALLOWED = {
    "files/csv_text.py",  # the reader
    "spheres/cloud_file.py",  # points of PLY and PCD as text
    "spheres/cloud_files.py",  # clouds as rows of numbers without headings
}


def test_nothing_else_reads_tables():
    found = set()
    for path in ROOT.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Attribute)
                and node.attr in READERS
                and isinstance(node.value, ast.Name)
                and node.value.id in ("csv", "np", "pd")
            ):
                found.add(path.relative_to(ROOT).as_posix())
    assert found == ALLOWED
