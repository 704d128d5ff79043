"""The diagnosis of trajectories in plain words."""

from __future__ import annotations

from mbcacq.diagnosis.text import VERDICTS, number

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
        gain = effect["held_out_gain"]
        lines.append(f"{effect['name']} at {', '.join(effect['where'])} (removes {gain:.0%} of the mean square, on data that took no part)")
        lines += [f"  {name} = {number(p['value'])} +- {number(p['std'])}" for name, p in effect["parameters"].items()]
    lines.append("")
    lines.append(f"On data that took no part (by {result['fit']['held_out']['split']}):")
    for f in result["fit"]["channels"]:
        held = f["held_out"]
        lines.append(f"  {f['at']} {PLACE[f['channel']]}: {held['before_rms']:.4g} {f['unit']} before, {held['after_rms']:.4g} after")
    return "\n".join(lines)
