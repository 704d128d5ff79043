"""A result as JSON text that carries the checksum of its own content: a changed bit never becomes a wrong tool on a controller."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbcacq.errors import ConfigError

SEAL = "sha256"


def sealed_text(content: Mapping[str, Any]) -> str:
    """The content as JSON, its last value the SHA-256 of the others (keys sorted, no spaces, shortest decimals)."""
    plain = json.loads(json.dumps({key: value for key, value in content.items() if key != SEAL}))
    return json.dumps({**plain, SEAL: _digest(plain)}, indent=1)


def unsealed(content: Any, file: Path) -> Any:
    """The content that was read, without its checksum; one without a checksum, of an earlier version or another program, is believed.
    Raises ConfigError where the checksum does not hold."""
    if not isinstance(content, dict) or SEAL not in content:
        return content
    plain = {key: value for key, value in content.items() if key != SEAL}
    try:
        same = content[SEAL] == _digest(plain)
    except RecursionError:  # nested as no result is
        same = False
    if not same:
        raise ConfigError(
            f"{file} is not as it was written: bits changed, or it was edited; write it anew with mbcacq calibrate --out, "
            f"or remove its '{SEAL}' to use it as it is"
        )
    return plain


def digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of a result's content, with its checksum or without."""
    return _digest(json.loads(json.dumps({key: value for key, value in content.items() if key != SEAL})))


def _digest(plain: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
