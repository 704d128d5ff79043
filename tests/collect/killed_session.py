"""PLAN CLOUDS FOLDER POSES: a session of clouds that kills itself, as kill -9 does, once so many poses were recorded."""

from __future__ import annotations

import os
import signal
import sys

import mbcacq
from mbcacq.acquisition import events


def main() -> None:
    plan, clouds, folder, count = sys.argv[1:]
    done = []

    def subscriber(event: events.Event) -> None:
        if isinstance(event, events.PoseDone):
            done.append(event)
            if len(done) == int(count):
                os.kill(os.getpid(), signal.SIGKILL)

    mbcacq.collect(plan, clouds, out=folder, operator=mbcacq.Operator(subscribers=(subscriber,)))


if __name__ == "__main__":
    main()
