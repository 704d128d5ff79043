"""What whoever uses a result must know first: that it is simulated, that it was never verified."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbcacq.errors import command_line
from mbcacq.model.cell import SIMULATED

UNVERIFIED = "never verified: no poses were kept apart to check these values; verify them before they are relied upon"


def export_command(result: Mapping[str, Any], source: object) -> str:
    """The command that writes a result for other programs, as it is accepted. A result of simulated data must be accepted as such. source:
    its file or folder."""
    return command_line("export", source, "--results", "results", *(("--simulated-anyway",) if result.get("simulated") else ()))


def caveats(result: Mapping[str, Any]) -> list[str]:
    """One sentence each, for the content of a result.json: simulated data, values without verification."""
    verified = bool((result.get("verification") or {}).get("places") or result.get("held_out"))
    return [*([SIMULATED] if result.get("simulated") else []), *([] if verified else [UNVERIFIED])]


def with_warnings(result: Mapping[str, Any]) -> list[str]:
    """The caveats, and what the calibration warned of: for whoever takes a result further and did not see how it was made."""
    return [*caveats(result), *(str(warning) for warning in result.get("warnings") or ())]
