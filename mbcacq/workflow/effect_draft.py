"""Drafts of effects: the most probable formula for each unmodelled effect, as a package that the diagnosis finds once it is installed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mbcacq.diagnosis.output.text import proposal_lines
from mbcacq.diagnosis.result import Proposal
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import finish_set, write_files
from mbcacq.files.template import filled

HERE = Path(__file__).parent


def write_draft(proposals: Sequence[Proposal], folder: Path) -> list[Path]:
    """Write a package with the most probable formula of each location: pyproject.toml, and a module an effect.

    Raises ConfigError if the folder holds something already, or cannot be written.
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
    texts = {"pyproject.toml": filled(HERE / "effect_draft.toml.j2", modules=modules)}
    texts |= {f"{module}.py": module_text(name, best[name]) for name, module in modules.items()}
    return write_files(folder, texts)


def name_of(term: EffectTerm) -> str:
    """The name of a draft, from where it acts and what it depends on: 'a5_by_q4_q6'."""
    return "_".join((*term.where, "by", *sorted(term.covariates))).lower()


def module_text(name: str, proposal: Proposal) -> str:
    """The module of one effect."""
    sentences = [line.strip() for line in proposal_lines((proposal,))]
    covariates = tuple(sorted(proposal.term.covariates))
    return filled(HERE / "effect_draft.py.j2", sentences=sentences, name=name, term=proposal.term, covariates=covariates)
