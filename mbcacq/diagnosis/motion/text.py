"""The diagnosis of trajectories in plain words."""

from __future__ import annotations

from mbcacq.diagnosis.output.text import VERDICTS, number

PLACE = {"q_joint": "joint-side against motor-side angle", "q_set": "actual angle against set point", "tau": "torque against the rigid arm"}


def trajectory_words(result: dict) -> str:
    lines = [VERDICTS[result["verdict"]], ""]
    if result["mismatch"]:
        lines.append("Where simulation and recording part:")
        for m in result["mismatch"][:12]:
            channel = f" ({PLACE[m['channel']]})" if "channel" in m else ""
            lines.append(f"  {m['at']:<8} depends on {m['depends_on']:<14} share {m['share']:.0%}{channel}")
        lines.append("")
    for effect in result["effects"]:
        gain = effect.get("held_out_gain_here", effect["held_out_gain"])
        where = ", ".join(effect["where"])
        lines.append(f"{effect['name']} at {where} (removes {gain:.1%} of the excess there, on data that took no part)")
        for name, p in effect["parameters"].items():
            values, stds = (x if isinstance(x, list) else [x] for x in (p["value"], p["std"]))
            lines.append(f"  {name} = {', '.join(f'{number(v)} +- {number(s)}' for v, s in zip(values, stds, strict=True))}")
    lines.append("")
    lines.append(f"On data that took no part (by {result['fit']['held_out']['split']}):")
    for f in result["fit"]["channels"]:
        held = f["held_out"]
        lines.append(f"  {f['at']} {PLACE[f['channel']]}: {held['before_rms']:.4g} {f['unit']} before, {held['after_rms']:.4g} after")
    return "\n".join(lines)
