"""The pages a user reads, and the shell commands they show."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Page:
    path: Path

    @property
    def name(self) -> str:
        return str(self.path.relative_to(ROOT))

    @property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @property
    def script(self) -> str:
        """All commands of the page in order, as one script."""
        return "\n".join(BLOCK.findall(self.text))


def pages() -> list[Page]:
    return [Page(ROOT / "README.md"), *(Page(p) for p in sorted((ROOT / "docs").rglob("*.md")))]
