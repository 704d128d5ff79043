"""External axes in the programs and the channel of EKI: they go with each PTP move, are checked against the plan's limits, and reported."""

from __future__ import annotations

import re

from mbcacq_kuka.eki.options import EkiOptions as EkiOptions

_MARGIN = 0.001  # REAL has 32 bits: a target on the limit must not be refused for its last digit


def moved(text: str, options: EkiOptions) -> str:
    """A file of the controller with the plan's external axes in it; those that the plan does not name stay where they are."""
    names, limits = options.axes[6:], options.limits[6:]
    last = max(int(name[1:]) for name in names)
    text = text.replace("GLOBAL AXIS ", "GLOBAL E6AXIS ").replace("DECL AXIS axes", "DECL E6AXIS axes")
    text = text.replace("A6 0.0}", f"A6 0.0,{','.join(f'{name} 0.0' for name in names)}}}")
    text = text.replace('"mbcacq 3"', f'"mbcacq 3 {" ".join(names)}"')
    # A line of A6 stands for a line of each external axis.
    for pattern in (r'[^\n]*Command/Axis/@A6"[^\n]*\n', r'[^\n]*Robot/State/Axis/@A6"[^\n]*\n'):
        text = re.sub(pattern, lambda found: found[0] + "".join(found[0].replace("A6", name) for name in names), text)
    refusals = "".join(
        f"   IF (axes.{name}<{low - _MARGIN:.3f}) OR (axes.{name}>{high + _MARGIN:.3f}) THEN\n"
        f"      RETURN ({20 + int(name[1:])})\n   ENDIF\n"
        for name, (low, high) in zip(names, limits.tolist(), strict=True)
    )
    lacking = f"   IF $EX_AX_NUM<{last} THEN\n      RETURN (19)\n   ENDIF\n"
    text = text.replace("   RETURN (0)\nENDFCT\n\nDEF mb_link_hello", f"{lacking}{refusals}   RETURN (0)\nENDFCT\n\nDEF mb_link_hello")
    speeds = f"   FOR k=1 TO {last}\n      $VEL_EXTAX[k]=mb_q_speed[n]\n      $ACC_EXTAX[k]=mb_q_accel[n]\n   ENDFOR\n"
    return text.replace("   PTP mb_q_axis[n]\n", f"{speeds}   PTP mb_q_axis[n]\n")
