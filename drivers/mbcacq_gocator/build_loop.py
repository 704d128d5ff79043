"""Compiles ``surface_loop.c`` where there is a compiler: at installation, or later by ``python -m mbcacq_gocator.build_loop``.

Imports nothing of this package, so that an installation can execute it before anything is installed.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).with_name("surface_loop.c")
_FLAGS = ("-O3", "-ffp-contract=off", "-shared", "-fPIC")  # without contraction the results are those of numpy to the last bit


def library_of(source: Path, folder: Path) -> Path:
    """Where the compiled loop stands. Its name holds the digest of the source, so that no other version is ever loaded."""
    return folder / f"_surface_loop_{hashlib.sha256(source.read_bytes()).hexdigest()[:16]}.so"


def build(source: Path, folder: Path) -> Path | None:
    """The library, compiled into ``folder``; None if it cannot be made. An earlier one is removed."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None or sys.platform == "win32":
        return None
    for old in folder.glob("_surface_loop_*.so"):
        old.unlink()
    library = library_of(source, folder)
    done = subprocess.run([compiler, *_FLAGS, "-o", str(library), str(source)], check=False, capture_output=True)
    return None if done.returncode else library


if __name__ == "__main__":
    built = build(SOURCE, SOURCE.parent)
    print(f"compiled: {built}" if built else "not compiled (no C compiler, or it failed); numpy does the same, slower")
