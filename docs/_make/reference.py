"""Writes what follows from the code: the pages of the reference on command line, plan schema and errors, and the schema of a diagnosis.

``python docs/_make/reference.py`` from the root of the checkout; tests compare them with what this makes.
"""

from __future__ import annotations

import json
from pathlib import Path

from command_line import command_line
from error_catalogue import error_catalogue
from plan_schema import plan_schema

from mbcacq.workflow.diagnosis_schema import generated_schema

REFERENCE = Path(__file__).resolve().parents[1] / "reference"
SCHEMA = Path(__file__).resolve().parents[2] / "mbcacq" / "diagnosis" / "schema" / "diagnosis-3.schema.json"
PAGES = {"command-line.md": command_line, "plan-schema.md": plan_schema, "errors.md": error_catalogue}


def main() -> None:
    REFERENCE.mkdir(exist_ok=True)
    for name, make in PAGES.items():
        (REFERENCE / name).write_text(make(), encoding="utf-8")
        print(REFERENCE / name)
    SCHEMA.write_text(json.dumps(generated_schema(), indent=1) + "\n", encoding="utf-8")
    print(SCHEMA)


if __name__ == "__main__":
    main()
