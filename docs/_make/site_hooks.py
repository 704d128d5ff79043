"""What the site has beyond ``docs/``: the pages of ``benchmarks/``, reference pages made from the code, a search that works offline."""

from __future__ import annotations

import re
import sys
from pathlib import Path, PurePosixPath

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "_make"))

from command_line import command_line  # noqa: E402
from error_catalogue import error_catalogue  # noqa: E402
from plan_schema import plan_schema  # noqa: E402

import mbcacq  # noqa: E402

REFERENCE = {"command-line.md": command_line, "plan-schema.md": plan_schema, "errors.md": error_catalogue}
SHIM = '<script src="https://unpkg.com/iframe-worker/shim"></script>'  # the theme's, fetched from outside
# What the theme lacks for a screen reader: a name of the search, no empty heads of columns.
ACCESSIBLE = (
    (re.compile(r'data-md-component="search" role="dialog"'), r'\g<0> aria-label="Search"'),
    (re.compile(r"<th( style=\"[^\"]*\")?></th>"), r"<td\1></td>"),
)
LINK = re.compile(r"(\]\()((?:\.\./)+)(docs|benchmarks)/")


def on_files(files: Files, config) -> Files:
    """Add every page of benchmarks/ at the same place in the site, and the pages that follow from the code."""
    for name, made in REFERENCE.items():
        files.append(File.generated(config, f"reference/{name}", content=made()))
    for page in sorted(p for p in (ROOT / "benchmarks").iterdir() if p.suffix in (".md", ".svg", ".webp")):
        files.append(File.generated(config, f"benchmarks/{page.name}", abs_src_path=str(page)))
    for name in ("site.js", "site.css"):
        files.append(File.generated(config, f"assets/{name}", abs_src_path=str(ROOT / "docs" / "_make" / name)))
    return files


def on_post_page(output: str, page, config) -> str:
    """Our own script in place of the theme's, which would be fetched from another host."""
    return _with_own_script(output, "../" * (len(PurePosixPath(page.file.src_uri).parents) - 1))


def on_post_template(output: str, template_name: str, config) -> str:
    """The same for the page that says that there is no such page; it lies at the root."""
    return _with_own_script(output, "/")


def _with_own_script(output: str, root: str) -> str:
    for lacking, mended in ACCESSIBLE:
        output = lacking.sub(mended, output)
    return output.replace(SHIM, f'<script src="{root}assets/site.js"></script>')


def on_page_markdown(markdown: str, page, config, files: Files) -> str:
    """Links from one of the two folders to the other, as they stand in the checkout, become links within the site. The page of the library
    names its members: they are imported when they are first used, which a reader of the source alone does not see."""
    if page.file.src_uri == "reference/python.md":
        markdown = markdown.replace("    options:\n", f"    options:\n      members: {sorted(mbcacq.__all__)}\n", 1)
    depth = len(PurePosixPath(page.file.src_uri).parents) - 1
    up = "../" * depth

    def within(match: re.Match) -> str:
        return match[1] + up + ("benchmarks/" if match[3] == "benchmarks" else "")

    return LINK.sub(within, markdown)
