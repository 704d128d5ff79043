"""The page "how it was found": block by block, what was doubted, what was chosen, what came out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbcacq.design.adaptive.investigation import Decision
from mbcacq.effects.catalogue import effects
from mbcacq.effects.in_words import spelt_out
from mbcacq.files.atomic_write import write_file
from mbcacq.files.template import filled
from mbcacq.quantities import capitalised, power_of_ten

PAGE = "how-it-was-found.html"
VERDICTS = {"none": "no effect", "cannot_tell": "cannot tell yet", "partly_explained": "partly explained"}


def write_investigation_page(folder: Path, name: str, decisions: Sequence[Decision]) -> Path:
    """Write the page into the folder of the run; it opens offline."""
    looks = [
        {
            "poses": d.poses,
            "moves": d.moves,
            "power": d.log_e_value / np.log(10),
            "sets": [(_words(name), odds) for name, odds in d.sets],
            "verdict": VERDICTS.get(d.verdict, d.verdict),
            "reasons": [_words(reason) for reason in d.reasons],
            "steps": d.steps,
            "end": d.end,
        }
        for d in decisions
    ]
    low = np.floor(min([-1.0, *(look["power"] for look in looks)]))
    high = np.ceil(max([3.0, *(look["power"] for look in looks)]))
    ticks = [(power, power_of_ten(10.0**power)) for power in np.unique(np.round(np.linspace(low, high, 5)))]
    end = decisions[-1].end or "the investigation is not finished" if decisions else "nothing was measured"
    page = Path(__file__).parent / "investigation.html.j2"
    write_file(folder / PAGE, filled(page, name=name, end=_words(capitalised(end)), looks=looks, low=low, high=high, ticks=ticks))
    return folder / PAGE


def _words(said: str) -> str:
    """The names of effects with spaces, and a station's name by itself: 'stationc2' is its location in an effect."""
    spelt = re.sub(rf"\b({'|'.join(effects())})\b", lambda name: spelt_out(name[0]), said)
    return re.sub(r"\bstation(?=[A-Za-z0-9])(?!s\b)", "station ", spelt)
