"""The outputs that pages show, made from a run of the page's own commands, and compared with such a run to the digits that matter.

``python docs/_make/printed.py docs/tutorials/your-own-arm.md ..`` executes the ``sh`` blocks of these pages, as a reader would paste them,
and writes the marked blocks anew: ``text`` blocks behind a line ``<!-- printed -->``. Their lines stand in the order in which they are
printed; a line ``...`` stands for any number of others. A line that is printed no more is named, to be chosen anew by hand. A test executes
the same commands and calls ``faults``. Some output needs data that no page can make (a cell that changed on the ninth day, two logs). It
stands behind a line ``<!-- printed by tests/FILE -->``; that test makes the data, and calls ``faults`` with its own name.
"""

from __future__ import annotations

import difflib
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)
MARKED = re.compile(r"^(<!-- printed -->\n```text\n)(.*?)(^```$)", re.DOTALL | re.MULTILINE)
BY_TEST = re.compile(r"^<!-- printed by (\S+) -->\n```text\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")
SHARE = 0.15  # by which a number may differ: runs are timed by a clock, and noise of a fake cell depends on the time
ROUNDING = 1e-9  # numbers below differ from machine to machine, and say the same
WINDOWS = 'xdg-open() { :; }; mbcacq() { [ "$1" = view ] || command mbcacq "$@"; }\n'  # nothing is opened
LIKE = 0.6  # similarity from which a printed line is the successor of a shown one


def faults(text: str, printed: str, by: str = "") -> list[str]:
    """The lines of the marked blocks of a page that were not printed, in this order. by: the test whose blocks are meant, '' for those of
    the page's own commands."""
    lines, at, out = [line.rstrip() for line in printed.splitlines()], 0, []
    blocks = [block for test, block in BY_TEST.findall(text) if test == by] if by else [block for _, block, _ in MARKED.findall(text)]
    for block in blocks:
        for shown in block.splitlines():
            if shown.strip() in ("", "..."):
                continue
            found = next((k for k in range(at, len(lines)) if same(shown, lines[k])), None)
            if found is None:
                out.append(shown)
            else:
                at = found + 1
    return out


def same(shown: str, printed: str) -> bool:
    """Whether two lines say the same: equal words, and numbers equal to the digits that matter."""
    if _words(shown) != _words(printed):
        return False
    return all(_alike(a, b) for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True))


def refreshed(text: str, printed: str) -> tuple[str, list[str]]:
    """The page with its marked blocks as they are printed now, and the lines that have no successor."""
    lines, lost, at = [line.rstrip() for line in printed.splitlines()], [], 0

    def block(found: re.Match[str]) -> str:
        nonlocal at
        out = []
        for shown in found[2].splitlines():
            if shown.strip() in ("", "..."):
                out.append(shown)
                continue
            scores = [difflib.SequenceMatcher(None, _words(shown), _words(line)).ratio() for line in lines[at:]]
            best = max(range(len(scores)), key=scores.__getitem__, default=None)
            if best is None or scores[best] < LIKE:
                lost.append(shown)
                out.append(shown)
            else:
                at += best + 1
                out.append(lines[at - 1])
        return found[1] + "".join(f"{line}\n" for line in out) + found[3]

    return MARKED.sub(block, text), lost


def _words(line: str) -> str:
    return " ".join(NUMBER.sub("#", line).split())


def _alike(shown: str, printed: str) -> bool:
    a, b = (float(number.replace("−", "-")) for number in (shown, printed))
    last = 10.0 ** -len(shown.partition("e")[0].partition(".")[2]) if "e" not in shown else 0.0
    return abs(a - b) <= max(SHARE * abs(b), 1.5 * last if last < 1 else 0.0, ROUNDING)


def main() -> None:
    for page in [Path(name) for name in sys.argv[1:] if name != "-v"]:
        text = page.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as desk:
            shutil.copytree(ROOT / "plans", Path(desk) / "plans")
            script = WINDOWS + "\n".join(SHELL.findall(text))
            path = f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin"
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", script],
                cwd=desk,
                env={"PATH": path, "HOME": desk, "LANG": "C.UTF-8"},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        if done.returncode:
            raise SystemExit(f"{page}: exit {done.returncode}\n{done.stdout}")
        text, lost = refreshed(text, done.stdout)
        page.write_text(text, encoding="utf-8")
        for line in lost:
            print(f"{page}: printed no more: {line}")
        if lost or "-v" in sys.argv:
            print(done.stdout)


if __name__ == "__main__":
    main()
