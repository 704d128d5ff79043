"""Whether this process may use as much memory as a run needs: asked before motion, since libraries end a process that gets none."""

from __future__ import annotations

import sys

from mbcacq.errors import SystemRefused

RUN_BYTES = 4 << 30  # on two cores a dry run of plans/quick.yaml fails with 3.1 GiB of addresses; most of them are never filled


def refuse_small_address_space() -> None:
    """Raises SystemRefused where a limit on the addresses of a process (ulimit -v) is below what a run needs."""
    if sys.platform == "win32":
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < RUN_BYTES:
        raise SystemRefused(
            f"a process may use {limit >> 20} MiB of addresses here, and a run needs {RUN_BYTES >> 20} MiB; raise the limit (ulimit -v)"
        )
