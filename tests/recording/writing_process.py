"""Records synthetic events for ever, in real time, and prints what it has handed over: to be killed. Arguments: folder [file size limit].

The limit stands for a full disk and needs POSIX.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import synthetic

from mbcacq.acquisition import events
from mbcacq.errors import MbcacqError
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.journal import Journal


def main(folder: str, limit: int | None) -> int:
    if limit is not None:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    rng = np.random.default_rng(0)
    try:
        with Recorder(folder) as recorder, Journal(folder) as journal:
            recorder(synthetic.start())
            journal(synthetic.start())
            start, number = time.monotonic(), 0
            while True:
                now = time.monotonic() - start
                recorder(events.CyclesReceived(now, synthetic.cycles(rng, now)))
                print(f"cycles {now!r} {time.monotonic() - start!r}", flush=True)
                if now > 0.12 * number:
                    for event in synthetic.pose(rng, number, now, points=20_000):
                        recorder(event)
                        journal(event)
                    print(f"pose {number} {time.monotonic() - start!r}", flush=True)
                    number += 1
                time.sleep(0.02)
    except MbcacqError as error:
        print(f"error {type(error).__name__}: {error}", flush=True)
        return int(error.exit_code)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else None))
