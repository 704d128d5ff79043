"""Writes the JSON Schema of a diagnosis from the types that make it: ``python docs/_make/reference.py``. A test compares them."""

from __future__ import annotations

import json
from pathlib import Path

from mbcacq.workflow.diagnosis_schema import generated_schema

SCHEMA = Path(__file__).resolve().parents[2] / "mbcacq" / "diagnosis" / "schema" / "diagnosis-3.schema.json"


def main() -> None:
    SCHEMA.write_text(json.dumps(generated_schema(), indent=1) + "\n", encoding="utf-8")
    print(SCHEMA)


if __name__ == "__main__":
    main()
