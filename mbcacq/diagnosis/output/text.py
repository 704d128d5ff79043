"""The diagnosis in plain words."""

from __future__ import annotations

from mbcacq.diagnosis.result import Diagnosis, EffectFound

VERDICTS = {
    "none": "No effect: the simulation explains the recording down to the measured noise.",
    "explained": "Explained: the effects below bring the simulation down to the measured noise.",
    "partly_explained": "Partly explained: the effects below help, but structure remains.",
    "unexplained": "Unexplained: there is a mismatch that no effect of the catalogue describes.",
    "cannot_tell": "Cannot tell: these poses do not let the candidates be told apart, or be seen.",
}
STANDS_IN = "A smooth model stands in its place."
SUSPECTED = "No model of it predicts what was left out: the place below is a suspicion."


def words(d: Diagnosis) -> str:
    lines = [VERDICTS[d.verdict]]
    if d.verdict == "unexplained":
        lines.append(STANDS_IN if any(e.held_out_gain > 0 for e in d.effects) else SUSPECTED)
    lines.append("")
    if d.mismatch:
        lines.append("Where simulation and recording part:")
        lines += [f"  {m['at']:<10} depends on {m['depends_on']:<18} share {m['share']:.0%}" for m in d.mismatch]
        lines.append("")
    for effect in d.effects:
        lines += describe(effect)
    before, after = d.fit["held_out"]["before_rms_mm"], d.fit["held_out"]["after_rms_mm"]
    lines.append(
        f"On data that took no part (by {d.fit['held_out']['split']}): {before:.4f} mm before, {after:.4f} mm after; "
        f"chi2/dof {d.fit['held_out']['before_chi2_dof']:.2f} before, {d.fit['held_out']['after_chi2_dof']:.2f} after; "
        f"noise alone makes {d.fit['repeatability_floor_mm']:.4f} mm."
    )
    lines += [f"Cannot be told apart: {' and '.join(pair['effects'])} (correlation {pair['correlation']:.2f})" for pair in d.not_separable]
    lines += [f"Measure next: {a['reason']}" for a in d.advice]
    lines += [f"Note: {note}." for note in d.notes]
    return "\n".join(lines)


def describe(effect: EffectFound) -> list[str]:
    out = [
        f"{effect.name} at {', '.join(effect.where)} (p = {effect.p_value:.1g}, removes {effect.held_out_gain:.0%} of the excess over "
        "noise)"
    ]
    for name, entry in list(effect.parameters.items())[:24]:
        out.append(f"  {name} = {number(entry['value'])} +- {number(entry['std'])}")
    if effect.alternatives:
        out.append(
            "  could also be: "
            + "; ".join(f"{a['name']} at {', '.join(a['where'])} ({a['held_out_gain']:.0%})" for a in effect.alternatives)
        )
    return [*out, ""]


def number(value) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(number(v) for v in value) + "]"
    return f"{value:.4g}"
