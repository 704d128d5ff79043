"""Does a diagnosis contradict itself? Rules over its text and its JSON content, which must tell one story.

    python benchmarks/statements.py FILE.json ...                            diagnoses that were kept (mbcacq diagnose --out)
    OMP_NUM_THREADS=1 python benchmarks/statements.py --challenges 40        and as many simulated cells of all kinds, diagnosed here

A line for each contradiction, then how many diagnoses have none. Exit code 1 where there is one.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from bench import PLANS

from mbcacq.challenge.run import take_all
from mbcacq.challenge.scenarios import draw, kinds
from mbcacq.diagnosis.effect_found import REMOVES_NOTHING
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.brief import brief
from mbcacq.diagnosis.output.text import is_to_be_calibrated_with, noise_floor, words
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.errors import ConfigError
from mbcacq.quantities import K

Rule = Callable[[Diagnosis, str], Iterator[str]]
SEED = 6700
NEAR_NOISE = 1.5  # chi2 per degree of freedom that is near the noise


def verdict_against_effects(d: Diagnosis, text: str) -> Iterator[str]:
    """What a verdict claims is among the effects, and nothing else is."""
    findings = [e for e in d.effects if not e.trend]
    if d.verdict == "none" and d.effects:
        yield "the verdict is none beside effects"
    if d.verdict == "explained" and not findings:
        yield "explained without a finding"
    if d.verdict == "explained" and any(e.name == UNKNOWN for e in d.effects):
        yield "explained beside something unmodelled"
    if d.verdict == "explained" and d.not_separable:
        yield "explained beside what cannot be told apart"
    if d.verdict == "explained" and any(not one.repeats for e in d.effects for one in e.found_again):
        yield "explained by what parts do not show again"
    if d.verdict == "unexplained" and not any(e.name == UNKNOWN for e in d.effects):
        yield "unexplained without anything unmodelled"
    if "A trend alone" in text and (findings or d.verdict != "cannot_tell"):
        yield f"the text knows a trend alone, the verdict is {d.verdict} with {len(findings)} findings"


def odds_against_words(d: Diagnosis, text: str) -> Iterator[str]:
    """What is excluded has odds below a twentieth, and what cannot be told apart above."""
    for pair in d.not_separable:
        if pair.odds is not None and pair.odds < OPTIONS.undecided:
            yield f"{' and '.join(pair.effects)} cannot be told apart at odds {pair.odds:.2g}"
    for line in text.splitlines():
        heading, _, rest = line.strip().partition(": ")
        for odds in re.findall(r"odds 1 : ([0-9.]+)", rest):
            if heading == "could also be" and 1 / float(odds) < 0.99 * OPTIONS.undecided:
                yield f"could also be at odds 1 : {odds}"
            if heading == "excluded in its place" and 1 / float(odds) > 1.01 * OPTIONS.undecided:
                yield f"excluded at odds 1 : {odds}"
        if heading in ("could also be", "Cannot be told apart") and "(excluded)" in rest:
            yield f"{heading}: excluded"


def alternatives_against_effects(d: Diagnosis, text: str) -> Iterator[str]:
    """What is stated stands in no other's place."""
    for effect in d.effects:
        here = {name.partition("(")[0] for name in effect.parameters}
        for other in (a for a in effect.alternatives if a.name == effect.name == UNKNOWN):
            if here & set(other.where):
                yield f"{effect.name} at {', '.join(other.where)} is stated and in the place of itself"


def gains_against_what_is_kept(d: Diagnosis, text: str) -> Iterator[str]:
    """What removes nothing removes no share; what is advised to be calibrated with is kept; what all effects remove is not nothing."""
    held = d.fit.held_out
    for block in text.split("\n\n"):
        if REMOVES_NOTHING in block and re.search(r"removes \d", block):
            yield "a share is removed by what held-out data are predicted as well without"
    for effect in d.effects:
        if effect.held_out_gain > 0.5 and effect.found_again and not any(one.found_in for one in effect.found_again):
            yield f"{effect.name} removes {effect.held_out_gain:.0%} of held-out excess, and no part of the recording shows it"
    if "calibrate with what was found" in text and not is_to_be_calibrated_with(d):
        yield "a calibration is advised where nothing is kept or something is open"
    removed = held.before_chi2_dof - held.after_chi2_dof
    excess = held.before_chi2_dof - 1
    if d.effects and removed > 0.5 * excess > 1.0 and all(e.trend == REMOVES_NOTHING for e in d.effects):
        yield f"chi2 falls from {held.before_chi2_dof:.2f} to {held.after_chi2_dof:.2f}, and each effect removes nothing"
    if "No model of it predicts held-out data" in text and removed > 0.5 * excess > 0.5:
        yield "no model predicts held-out data, and they are predicted"
    if held.after_chi2_dof > 1.05 * held.before_chi2_dof and held.after_chi2_dof > NEAR_NOISE:
        yield f"chi2 of held-out data rises from {held.before_chi2_dof:.2f} to {held.after_chi2_dof:.2f} with what was found"


def figures_against_counts(d: Diagnosis, text: str) -> Iterator[str]:
    """No share is above all, no count above its total; robust figures are of fewer centres than all."""
    for part, whole in re.findall(r"\b(\d+) of (\d+)\b", text):
        if int(part) > int(whole):
            yield f"{part} of {whole}"
    for share in re.findall(r"removes ([0-9.]+)%", text):
        if float(share) > 100:
            yield f"removes {share} %"
    held = d.fit.held_out
    if held.robust_centres > held.centres:
        yield "robust figures are of more centres than there are"
    if held.rejects and "robust" not in text:
        yield "robust figures without that name"
    rejected = re.search(r"(\d+) of \d+ measured centres (?:are|is) ", text)
    if rejected and held.centres and int(rejected[1]) != held.centres - held.robust_centres:
        yield f"{rejected[1]} centres rejected, {held.centres - held.robust_centres} left out of the robust figure"


def uncertainty_against_held_out(d: Diagnosis, text: str) -> Iterator[str]:
    """A model that is said to reach the noise does so on held-out data; no finding states what its uncertainty covers."""
    left = d.fit.held_out.after_chi2_dof
    if "down to the measured noise." in text.split("\n")[0] and noise_floor(d).is_excess(left) and left > NEAR_NOISE:
        yield f"down to the measured noise at a held-out chi2 of {left:.2f}"
    for effect in (e for e in d.effects if not e.trend):
        for name, estimate in effect.parameters.items():
            if name.endswith(".order") and any(K * std > max(0.5, 0.5 * value) for value, std in zip(*estimate.components, strict=True)):
                yield f"{effect.name}: {name} is stated although its uncertainty is {max(estimate.components[1]):.2g}"
        stated = {one.at for one in effect.orders if one.determined}
        for name in effect.parameters:
            at, _, quantity = name.rpartition(".")
            if quantity == "order" and effect.orders and at not in stated:
                yield f"{name} is stated, and no line of {at} is determined"


def text_against_json(d: Diagnosis, text: str) -> Iterator[str]:
    """Every finding and every trend of the JSON content is in the text, and the content survives reading and writing."""
    for effect in d.effects:
        if f" at {', '.join(effect.where)}" not in text:
            yield f"{effect.name} at {', '.join(effect.where)} is not in the text"
    if Diagnosis.from_json(json.loads(json.dumps(d.to_json()))).to_json() != d.to_json():
        yield "the content differs once it was read"
    if brief(d).splitlines()[0] != text.splitlines()[0]:
        yield "one screen begins with another verdict than the whole text"


RULES: tuple[Rule, ...] = (
    verdict_against_effects,
    odds_against_words,
    alternatives_against_effects,
    gains_against_what_is_kept,
    figures_against_counts,
    uncertainty_against_held_out,
    text_against_json,
)


def contradictions(d: Diagnosis) -> list[str]:
    """All that a diagnosis says against itself."""
    text = words(d)
    return [f"{rule.__name__.replace('_', ' ')}: {one}" for rule in RULES for one in rule(d, text)]


def diagnoses(files: list[Path], challenges: int) -> Iterator[tuple[str, Diagnosis]]:
    """Those of files, each of which may hold others beside a motion, then of simulated cells."""
    for file in files:
        content = json.loads(file.read_text(encoding="utf-8"))
        content = content.get("poses", content) if isinstance(content, dict) else content
        try:
            yield file.name, Diagnosis.from_json(content)
        except ConfigError:
            print(f"{file.name}: no diagnosis of poses", file=sys.stderr)
    drawn = draw(SEED, challenges, [*kinds("mixed"), "two"])
    for outcome in take_all(PLANS / "seeing.yaml", drawn) if challenges else ():
        yield f"cell {outcome.scenario.number} ({outcome.scenario.kind})", Diagnosis.from_json(outcome.diagnosis)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--challenges", type=int, default=0)
    given = parser.parse_args()
    count = bad = 0
    for name, found in diagnoses(given.files, given.challenges):
        said = contradictions(found)
        count, bad = count + 1, bad + bool(said)
        print(*(f"{name}: {one}" for one in said), sep="\n", end="\n" if said else "")
    print(f"{count - bad} of {count} diagnoses without a contradiction")
    sys.exit(bool(bad))
