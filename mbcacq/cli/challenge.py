"""``mbcacq challenge``: inject effects into the fake cell, diagnose without knowing them, compare with the truth, score."""

from __future__ import annotations

from pathlib import Path

import click
from rich import box
from rich.table import Table

from mbcacq.challenge import run
from mbcacq.challenge import scenarios as drawn_scenarios
from mbcacq.challenge import table as results_table
from mbcacq.cli.declared import FOLDER, Answer, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.errors import ConfigError
from mbcacq.model import shipped

# Headings of the table where they differ from the keys of its rows: broken so that all ten fit 80 columns.
SHORT = {
    "challenges": "tried",
    "that count": "that\ncount",
    "and placed": "and\nplaced",
    "share of achievable": "of what is\nachievable",
    "parameters within 3 sigma": "within\n3 sigma",
    "confidently wrong": "surely\nwrong",
    "false alarms": "false\nalarms",
}


@subcommand("challenge")
def command(
    seed: int = option("Seed of everything: cells, effects, strengths.", default=0),
    count: int = option("Number of challenges.", click.IntRange(1), default=10),
    plan: Path | None = option("Plan to execute [default: the tool's plans/seeing.yaml]."),
    effects: str = option(
        "What to inject: catalogue, outside, none, two (at once), mixed, or names; separated by commas.", default="mixed"
    ),
    protocols: bool = option(
        "Run the plan against the fake cell's servers (about a minute each), or compute what it would record (milliseconds).",
        None,
        "--through-protocols/--fast",
        default=True,
    ),
    outliers: float = option("Share of grossly wrong centres (only with --fast).", click.FloatRange(0, 0.2), default=0.0),
    missing: tuple[str, ...] = option("A column that is not recorded (repeatable).", ["time_s", "temperature", "direction"]),
    jobs: int = option("Processes.", click.IntRange(1, 16), default=1),
    out: Path | None = option("Keep recordings, diagnoses and the true scenarios in this folder.", FOLDER),
) -> Answer:
    """Inject effects into the fake cell, run the plan, diagnose the recordings without knowing them, then compare with the truth and score.

    \b
    Examples:
      mbcacq challenge --count 3                       through the real protocols
      mbcacq challenge --fast --count 32 --effects catalogue   each effect twice
      mbcacq challenge --fast --count 50 --effects none        false alarms
    """
    import numpy as np

    if protocols and outliers:
        raise ConfigError("gross outliers can only be made with --fast; leave out --outliers, or add --fast")
    wanted = drawn_scenarios.kinds(effects, missing)
    order = np.random.default_rng([seed, 21]).permutation(len(wanted))
    scenarios = drawn_scenarios.draw(seed, count, [wanted[i] for i in order], outliers, missing)

    with StepProgress() as progress:
        done = 0

        def report(outcome: run.Outcome) -> None:
            nonlocal done
            done += 1
            progress.clear()
            echo(f"{outcome.scenario.number:4}  {results_table.line(outcome.score)}  {outcome.seconds:.1f} s", err=True)
            if done < count:
                progress.begin(f"challenge {done + 1} of {count}")

        progress.begin(f"challenge 1 of {count}")
        outcomes = run.take_all(plan or shipped.folder() / "seeing.yaml", scenarios, protocols, out, jobs, report)
    rows = results_table.summary([o.score for o in outcomes])
    document = {"format": "mbcacq-challenge/1", "seed": seed, "table": rows, "challenges": [o.to_dict() for o in outcomes]}
    return Answer(document, [table_of(rows)], ("see what a plan of yours can show", command_line("plan", "check", plan or "seeing")))


def table_of(rows: list[dict]) -> Table:
    table = Table(box=box.HORIZONTALS, padding=(0, 0), pad_edge=False, collapse_padding=True)
    for i, name in enumerate(results_table.COLUMNS):
        table.add_column(SHORT.get(name, name), justify="left" if i == 0 else "right", min_width=12 if i == 0 else None)
    for entry in rows:
        table.add_row(entry["kind"].replace("_", " "), *results_table.cells(entry)[1:])
    return table
