"""Paths as the rerun library takes them."""

from __future__ import annotations

import os
from pathlib import Path

from mbcacq.errors import ConfigError


def rerun_path(path: Path | str) -> str:
    """The path as text whose UTF-8 bytes are the file's name on the disk, whatever encoding the locale has (LANG=C).

    Raises ConfigError if the name is not UTF-8 at all, which the library cannot open.
    """
    if os.name == "nt":
        return str(path)
    try:
        return os.fsencode(path).decode("utf-8")
    except UnicodeDecodeError:
        shown = ascii(str(path))[1:-1]
        raise ConfigError(f"the name {shown} is not UTF-8, and recordings cannot be used below it; rename the folder") from None
