"""The JSON Schema of a diagnosis, format mbcacq-diagnosis/3: the contract with programs that read it."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any


def schema_text() -> str:
    """The schema as it is kept (JSON Schema 2020-12)."""
    return files(__name__).joinpath("diagnosis-3.schema.json").read_text(encoding="utf-8")


def diagnosis_schema() -> dict[str, Any]:
    """The schema as Python lists and dictionaries."""
    return json.loads(schema_text())
