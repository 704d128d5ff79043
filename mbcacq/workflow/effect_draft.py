"""Drafts of effects: the most probable formula for each unmodelled effect, as a package that the diagnosis finds once it is installed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mbcacq.diagnosis.output.text import proposal_lines
from mbcacq.diagnosis.result import Proposal
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.effects.functions import Column, DescribedPart, Function, Product
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import finish_set, write_files

PROJECT = """[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "{package}"
version = "0.1"
description = "Effects proposed by mbcacq diagnose"
dependencies = ["mbcacq", "numpy"]

[project.entry-points."mbcacq.effects"]
{points}

[tool.setuptools]
py-modules = [{modules}]
"""

MODULE = '''"""Draft of an effect, proposed by mbcacq diagnose --propose.

{sentences}

Rename it, replace the formula by the physics that it reminds of, and state typical sizes: thirty times as much is disbelieved.
"""

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, plain_effect
from mbcacq.effects.functions import DescribedPart, Function, Product

NAME = "{name}"
WHERE = {where!r}
DEPENDS_ON = "{depends_on}"

# Each coefficient has the name under which it is reported, which ends with its unit, and its size in a real cell.
PARAMETERS = {{
{parameters}
}}

# What moves: place, index of the joint or frame (from 0), component (0 to 2: mm along x, y, z; 3 to 5: rad about them); then a column
# for each coefficient, which is a sum of products of functions of one covariate each.
PARTS = [
{parts}
]


def candidates(context: Context) -> list[Candidate]:
    """One candidate. A recording without one of the covariates does not have it."""
    for name in {covariates!r}:
        context.value(name)
    return [plain_effect(NAME, WHERE, DEPENDS_ON, PARTS, PARAMETERS)]
'''


def write_draft(proposals: Sequence[Proposal], folder: Path) -> list[Path]:
    """Write a package with the most probable formula of each location: pyproject.toml, and a module an effect.

    Raises ConfigError where the folder holds something already, or cannot be written.
    """
    best: dict[str, Proposal] = {}
    for one in proposals:
        best.setdefault(name_of(one.term), one)
    modules = {name: f"mbcacq_effect_{name}" for name in best if best[name].odds == 1.0}
    if not modules:
        raise ConfigError("there is no formula to write a draft of")
    finish_set(folder)  # a draft that was stopped
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder} exists already and is not empty; give another folder to --propose")
    points = "\n".join(f'{name} = "{module}"' for name, module in modules.items())
    listed = ", ".join(f'"{module}"' for module in modules.values())
    package = f"mbcacq-effect-{next(iter(modules)).replace('_', '-')}"
    texts = {"pyproject.toml": PROJECT.format(package=package, points=points, modules=listed)}
    texts |= {f"{module}.py": module_text(name, best[name]) for name, module in modules.items()}
    return write_files(folder, texts)


def name_of(term: EffectTerm) -> str:
    """The name of a draft, from where it acts and what it depends on: 'a5_by_q4_q6'."""
    return "_".join((*term.where, "by", *sorted(term.covariates))).lower()


def module_text(name: str, proposal: Proposal) -> str:
    """The module of one effect."""
    term = proposal.term
    return MODULE.format(
        sentences="\n".join(line.strip() for line in proposal_lines((proposal,))),
        name=name,
        where=term.where,
        depends_on=term.depends_on,
        parameters="\n".join(f'    "{p}": {size!r},' for p, size in zip(term.names, term.typical.tolist(), strict=True)),
        parts="\n".join(_part(part) for part in term.parts),
        covariates=tuple(sorted(term.covariates)),
    )


def _part(part: DescribedPart) -> str:
    columns = "".join(f"            {_column(column)},\n" for column in part.columns)
    place = f'        "{part.place}",\n        {part.index},\n        {part.component},\n'
    return f"    DescribedPart(\n{place}        (\n{columns}        ),\n    ),"


def _column(column: Column) -> str:
    return "()" if not column else f"({', '.join(_product(p) for p in column)},)"


def _product(p: Product) -> str:
    return (
        f"Product({p.factor!r}, ({''.join(f'{_function(f)}, ' for f in p.functions).rstrip(' ')}))"
        if p.functions
        else f"Product({p.factor!r})"
    )


def _function(f: Function) -> str:
    return f'Function("{f.covariate}", "{f.kind}", {f.numbers!r})'
