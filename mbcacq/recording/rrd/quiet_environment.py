"""The environment in which the rerun program is started: it reports nothing, asks for no update and writes nothing into the user's home."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NOWHERE = "http://127.0.0.1:9"  # this computer's discard port, as the proxy of all requests: the update check has no switch
LOCAL = "127.0.0.1,localhost,::1"


@contextmanager
def quiet_environment() -> Iterator[dict[str, str]]:
    """Environment variables for a child, good until the block ends.

    Analytics is off by a configuration file in a temporary folder, so that no persistent id is made; requests to other computers find a
    proxy that refuses them. On Windows rerun takes its configuration from a folder that no variable names: there only the proxy helps.
    """
    with tempfile.TemporaryDirectory(prefix="mbcacq-rerun-", ignore_cleanup_errors=True) as made:
        home = Path(made)
        config, data = home / "config", home / "data"
        changed = {"XDG_CONFIG_HOME": str(config), "XDG_DATA_HOME": str(data)}
        scratch = home / "scratch"  # the viewer leaves a folder there when it is terminated
        scratch.mkdir()
        changed |= dict.fromkeys(("TMPDIR", "TMP", "TEMP"), str(scratch))
        folders = [(config / "rerun", data / "rerun" / "analytics")]
        if sys.platform == "darwin":
            changed["HOME"] = made
            support = home / "Library" / "Application Support" / "rerun"
            folders.append((support, support / "analytics"))
        for place, kept in folders:
            place.mkdir(parents=True)
            settings = {"analytics_enabled": False, "analytics_id": "", "metadata": {}}  # rerun replaces a file that lacks a key
            settings |= {"config_file_path": str(place / "analytics.json"), "data_dir_path": str(kept)}
            (place / "analytics.json").write_text(json.dumps(settings), encoding="utf-8")
        for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
            changed |= {name: NOWHERE, name.lower(): NOWHERE}
        yield {**os.environ, **changed, "NO_PROXY": LOCAL, "no_proxy": LOCAL}
