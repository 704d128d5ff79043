"""Every ticked point of the metrologist's checklist stands in the report of a dry run, in the words that the page gives."""

import html
import re
from collections.abc import Callable
from pathlib import Path

from finished_runs import FinishedRun

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "metrologists-checklist.md"
ROW = re.compile(r"^\| (.+?) \| (✓|–|by hand) \| (.+?) \|$", re.MULTILINE)


def test_the_words_of_every_ticked_point_stand_in_a_report(finished_run: Callable[[str], FinishedRun]):
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    ticked = [(point, where) for point, met, where in rows if met == "✓"]
    assert len(ticked) > 20
    assert all(re.fullmatch(r"`[^`]+`", where) for _, where in ticked)
    page = (finished_run("kuka.yaml").folder / "report.html").read_text(encoding="utf-8")
    words = " ".join(html.unescape(re.sub(r"<script.*?</script>|<style.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL)).split())
    assert [point for point, where in ticked if where.strip("`") not in words] == []
