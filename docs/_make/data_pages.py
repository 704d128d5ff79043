"""The pages of docs/data show what ``mbcacq diagnose`` prints: from diagnoses that are kept beside them, so that the words are today's.

    python docs/_make/data_pages.py [DIAGNOSIS.json ..]    # made by mbcacq diagnose SET --out SET.json; named after its set

Keeps of each given diagnosis what its words are made of as docs/data/SET.words.json, and writes the blocks of all pages anew: a
``text`` block behind a line ``<!-- printed by mbcacq diagnose SET -->``. A test compares them.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from mbcacq.workflow.diagnosis_result import DiagnosisResult

DATA = Path(__file__).resolve().parents[1] / "data"
BLOCK = re.compile(r"^(<!-- printed by mbcacq diagnose (\S+) -->\n```text\n)(.*?)(^```$)", re.DOTALL | re.MULTILINE)
NOT_IN_WORDS = ("evidence", "provenance", "dropped", "recordings")  # keys of a diagnosis, a third of its size


def kept(text: str) -> str:
    """The JSON of a diagnosis without what its words do not need. They say of its model only that there is one: its
    shortest term is kept."""
    whole = json.loads(text)
    content = {key: value for key, value in whole.items() if key not in NOT_IN_WORDS}
    if "channels" in whole["fit"]:  # of motion: whether there is an effect is said, the sets of effects are not
        content["evidence"] = [one | {"evidence": one["evidence"] | {"sets": [], "untried": []}} for one in whole["evidence"]]
    if content.get("model"):
        content["model"]["terms"] = sorted(content["model"]["terms"], key=lambda term: len(json.dumps(term)))[:1]
        content["model"]["learnt"] = {**content["model"]["learnt"], "anchors": []}
    return json.dumps(content, ensure_ascii=False) + "\n"


def printed(name: str) -> str:
    """What a page shows of the diagnosis of a set: verdict and effects."""
    words = DiagnosisResult.from_json((DATA / f"{name}.words.json").read_text(encoding="utf-8")).text
    return words.split("\nWhere model and data")[0].rstrip() + "\n"


def refreshed(page: str) -> str:
    """The text of a page with its blocks as they are printed today."""
    return BLOCK.sub(lambda found: f"{found[1]}{printed(found[2])}{found[4]}", page)


def main() -> None:
    for file in map(Path, sys.argv[1:]):
        (DATA / f"{file.stem}.words.json").write_text(kept(file.read_text(encoding="utf-8")), encoding="utf-8")
    for page in DATA.glob("*.md"):
        page.write_text(refreshed(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
