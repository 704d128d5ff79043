"""Inputs for the parsers, kept because each takes a way through the code that no other takes: ``corpus/NAME.jsonl``, a string a line.

A character of a string is a byte. ``python benchmarks/fuzz.py --grow`` adds to them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

FOLDER = Path(__file__).resolve().parent / "corpus"


def corpus(name: str) -> tuple[bytes, ...]:
    """The kept inputs of a target; none where there is no file."""
    path = _path(name)
    return tuple(json.loads(line).encode("latin-1") for line in path.read_text().splitlines()) if path.exists() else ()


def write_corpus(name: str, inputs: Sequence[bytes]) -> None:
    FOLDER.mkdir(exist_ok=True)
    _path(name).write_text("".join(json.dumps(data.decode("latin-1")) + "\n" for data in inputs))


def _path(name: str) -> Path:
    return FOLDER / f"{name.replace(',', '').replace(' ', '-').lower()}.jsonl"
