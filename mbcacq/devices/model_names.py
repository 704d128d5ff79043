"""Whether two texts name one model of a device, in whatever way each of them writes it."""

from __future__ import annotations

import re


def same_model(wanted: str, reported: str) -> bool:
    """Whether ``reported`` holds every word of ``wanted``, in its order and without a gap.

    Words are runs of letters and runs of digits: 'KR 210 R2700-2' is '#KR210R2700_2 C4 FLR', and 'KR 10' is not 'KR 1000 titan'. The
    maker's name KUKA may be missing.
    """
    asked, found = (re.findall(r"[a-z]+|\d+", re.sub("kuka", " ", text.lower())) for text in (wanted, reported))
    return any(found[k : k + len(asked)] == asked for k in range(len(found) - len(asked) + 1))
