"""What a check left in the folder of its recording: its verdict with the history so far, as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.files.atomic_write import write_file
from mbcacq.recording.run_folder.register import CHECK_RESULT

FORMAT = "mbcacq-check-result/1"


def keep_check_result(run: Path, content: dict[str, Any]) -> None:
    """Write the verdict into the folder of its recording. Raises RecordingError."""
    write_file(run / CHECK_RESULT, json.dumps(content, indent=1) + "\n")


def read_check_result(run: Path) -> dict[str, Any]:
    """What a check said, from the folder of its recording. Raises ConfigError if it says nothing that can be read."""
    path = run / CHECK_RESULT
    advice = f"judge the check: mbcacq check RESULT PLAN --from {run}"
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise ConfigError(f"{run} is a check that was not judged; {advice}") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}; make it readable") from error
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or content.get("format") != FORMAT or not {"sentence", "times", "verdict"} <= content.keys():
        raise ConfigError(f"{path} is damaged, or another version wrote it; repeat the check, which writes one anew")
    return content
