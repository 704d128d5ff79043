"""Writes the pages of the reference that follow from the code: command line, plan schema, errors.

``python docs/_make/reference.py`` from the root of the checkout; a test compares the pages with what this makes.
"""

from __future__ import annotations

from pathlib import Path

from command_line import command_line
from error_catalogue import error_catalogue
from plan_schema import plan_schema

REFERENCE = Path(__file__).resolve().parents[1] / "reference"
PAGES = {"command-line.md": command_line, "plan-schema.md": plan_schema, "errors.md": error_catalogue}


def main() -> None:
    REFERENCE.mkdir(exist_ok=True)
    for name, make in PAGES.items():
        (REFERENCE / name).write_text(make(), encoding="utf-8")
        print(REFERENCE / name)


if __name__ == "__main__":
    main()
