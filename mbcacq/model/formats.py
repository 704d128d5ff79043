"""Formats of files, 'mbcacq-NAME/NUMBER': what a newer program wrote is no damage, and must not be 'corrected'."""

from __future__ import annotations

import re
from collections.abc import Sequence

_FORMAT = re.compile(r"(mbcacq-[a-z-]+)/(\d+)")


def newer_format(found: object, known: str | Sequence[str]) -> str:
    """A sentence where a file's format is one of ours with a higher number than this program knows, '' otherwise.

    found: what stands under the key 'format', of any type. known: the formats that are read.
    """
    names = (known,) if isinstance(known, str) else tuple(known)
    match = _FORMAT.fullmatch(found) if isinstance(found, str) else None
    if match is None:
        return ""
    numbers = [int(one[2]) for name in names if (one := _FORMAT.fullmatch(name)) and one[1] == match[1]]
    if not numbers or int(match[2]) <= max(numbers):
        return ""
    return (
        f"was written by a newer mbcacq: its format is '{found}', this one reads up to '{match[1]}/{max(numbers)}'; "
        "update this one (pip install --upgrade mbcacq)"
    )
