"""``mbcacq fakes``: the fake cell of a plan, in the foreground, at the plan's own addresses."""

from __future__ import annotations

import signal
import time
from pathlib import Path

from mbcacq import devices
from mbcacq import plan as plans
from mbcacq.acquisition import device_check
from mbcacq.cli.declared import argument, option, subcommand
from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.errors import ConfigError


@subcommand("fakes")
def command(
    plan: Path = argument(PlanPath()),
    fast: bool = option("Lock-step: as fast as the client answers, instead of real time at 4 ms."),
    program: Path | None = option("Folder of a robot program: play it, and save its clouds (--clouds)."),
    clouds: Path | None = option("Folder for the clouds of --program, and joints.csv."),
    seed: int = option("Seed of everything the fake world draws.", default=0),
) -> None:
    """Start the fake cell of PLAN; run the plan from another terminal with `mbcacq run PLAN`. Ctrl-C ends it.

    With --program, a program of `mbcacq plan program` is played in the fake cell instead, as a rehearsal of `mbcacq collect`.
    """
    loaded = plans.load(plan)
    device_check.refuse_impossible_devices(loaded)
    with StepProgress("looking for postures that reach every pose") as steps:
        poses = plans.expand(loaded)
        if program is not None or clouds is not None:
            if program is None or clouds is None:
                raise ConfigError("--program and --clouds belong together; give the folder of the program and one for its clouds")
            steps.begin("playing the program")
            files = devices.load_driver("fakes", "rehearsal")(loaded, poses, program, clouds, seed=seed)
            echo(f"{len(files) - 1} clouds and {files[-1]}")
            say_next("make a run of them", command_line("collect", plan, "--clouds", clouds, "--joints", files[-1]))
            return
    ended: list[int] = []  # no event: a second signal inside of its set() would wait for the first for ever
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: ended.append(number))
    with devices.load_driver("fakes", "cell")(loaded, poses, realtime=not fast, seed=seed, ports="plan") as cell:
        echo(f"fake cell of '{loaded.plan.name}' is up:")
        for role, options in cell.overrides().items():
            if places := ", ".join(f"{k} {v}" for k, v in options.items() if v not in ("", None) and not callable(v)):
                echo(f"  {role}: {places}")
        echo("Ctrl-C here ends the fake cell")
        say_next("in another terminal", command_line("run", plan, "--yes"))
        while not ended:
            time.sleep(0.1)
