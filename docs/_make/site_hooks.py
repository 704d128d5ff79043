"""The site shows the pages of ``benchmarks/`` too, under the links that work in a checkout."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(\]\()((?:\.\./)+)(docs|benchmarks)/")


def on_files(files: Files, config) -> Files:
    """Add every page of benchmarks/ at the same place in the site."""
    for page in sorted(p for p in (ROOT / "benchmarks").iterdir() if p.suffix in (".md", ".svg")):
        files.append(File.generated(config, f"benchmarks/{page.name}", abs_src_path=str(page)))
    return files


def on_page_markdown(markdown: str, page, config, files: Files) -> str:
    """Links from one of the two folders to the other, as they stand in the checkout, become links within the site."""
    depth = len(PurePosixPath(page.file.src_uri).parents) - 1
    up = "../" * depth

    def within(match: re.Match) -> str:
        return match[1] + up + ("benchmarks/" if match[3] == "benchmarks" else "")

    return LINK.sub(within, markdown)
