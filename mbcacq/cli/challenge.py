"""``mbcacq challenge``: inject effects into the fake cell, diagnose without knowing them, compare with the truth, score."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import console as terminal_console
from mbcacq.cli.terminal import echo

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


@click.command("challenge")
@click.option("--seed", default=0, show_default=True, help="Seed of everything: cells, effects, strengths.")
@click.option("--count", default=10, show_default=True, type=click.IntRange(1), help="Number of challenges.")
@click.option("--plan", type=click.Path(path_type=Path), help="Plan to execute [default: the tool's plans/seeing.yaml].")
@click.option(
    "--effects",
    default="mixed",
    show_default=True,
    help="What to inject: catalogue, outside, none, two (at once), mixed, or names; separated by commas.",
)
@click.option(
    "--through-protocols/--fast",
    "protocols",
    default=True,
    show_default=True,
    help="Run the plan against the fake cell's servers (about a minute each), or compute what it would record (milliseconds).",
)
@click.option(
    "--outliers", default=0.0, show_default=True, type=click.FloatRange(0, 0.2), help="Share of grossly wrong centres (only with --fast)."
)
@click.option(
    "--missing",
    multiple=True,
    type=click.Choice(["time_s", "temperature", "direction"]),
    help="A column that is not recorded (repeatable).",
)
@click.option("--jobs", default=1, show_default=True, type=click.IntRange(1, 16), help="Processes.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Keep recordings, diagnoses and the true scenarios in this folder."
)
@click.option("--json", "as_json", is_flag=True, help="Print scores and table as one JSON object on stdout.")
def command(
    seed: int,
    count: int,
    plan: Path | None,
    effects: str,
    protocols: bool,
    outliers: float,
    missing: tuple[str, ...],
    jobs: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Inject effects into the fake cell, run the plan, diagnose the recordings without knowing them, then compare with the truth and score.

    \b
    Examples:
      mbcacq challenge --count 3                       through the real protocols
      mbcacq challenge --fast --count 32 --effects catalogue   each effect twice
      mbcacq challenge --fast --count 50 --effects none        false alarms
    """
    import numpy as np

    from mbcacq.challenge.run import Outcome, take_all
    from mbcacq.challenge.scenarios import draw, kinds
    from mbcacq.challenge.table import line, summary
    from mbcacq.errors import ConfigError
    from mbcacq.model import shipped

    if protocols and outliers:
        raise ConfigError("gross outliers can only be made with --fast; leave out --outliers, or add --fast")
    wanted = kinds(effects, missing)
    order = np.random.default_rng([seed, 21]).permutation(len(wanted))
    scenarios = draw(seed, count, [wanted[i] for i in order], outliers, missing)

    with StepProgress() as progress:
        done = 0

        def report(outcome: Outcome) -> None:
            nonlocal done
            done += 1
            progress.clear()
            echo(f"{outcome.scenario.number:4}  {line(outcome.score)}  {outcome.seconds:.1f} s", err=True)
            if done < count:
                progress.begin(f"challenge {done + 1} of {count}")

        progress.begin(f"challenge 1 of {count}")
        outcomes = take_all(plan or shipped.folder() / "seeing.yaml", scenarios, protocols, out, jobs, report)
    rows = summary([o.score for o in outcomes])
    if as_json:
        echo(json.dumps({"format": "mbcacq-challenge/1", "seed": seed, "table": rows, "challenges": [o.to_dict() for o in outcomes]}))
    else:
        print_table(rows)
        say_next("see what a plan of yours can show", command_line("plan", "check", plan or "seeing"))


def print_table(rows: list[dict]) -> None:
    from rich import box
    from rich.table import Table

    from mbcacq.challenge.table import COLUMNS, cells

    table = Table(box=box.HORIZONTALS, padding=(0, 0), pad_edge=False, collapse_padding=True)
    for i, name in enumerate(COLUMNS):
        table.add_column(SHORT.get(name, name), justify="left" if i == 0 else "right", min_width=12 if i == 0 else None)
    for entry in rows:
        table.add_row(entry["kind"].replace("_", " "), *cells(entry)[1:])
    terminal_console().print(table)
