"""``mbcacq challenge``: inject effects into the fake cell, diagnose without knowing them, compare with the truth, score."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.terminal import console as terminal_console
from mbcacq.cli.terminal import echo


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
      mbcacq challenge --count 3                                 through the real protocols
      mbcacq challenge --fast --count 32 --effects catalogue     every effect of the catalogue twice
      mbcacq challenge --fast --count 50 --effects none          how often is there a false alarm
    """
    import numpy as np

    from mbcacq.challenge.run import take_all
    from mbcacq.challenge.scenarios import draw, kinds
    from mbcacq.challenge.table import line, summary
    from mbcacq.errors import ConfigError
    from mbcacq.model import shipped

    if protocols and outliers:
        raise ConfigError("gross outliers can only be made with --fast; leave out --outliers, or add --fast")
    wanted = kinds(effects, missing)
    order = np.random.default_rng([seed, 21]).permutation(len(wanted))
    scenarios = draw(seed, count, [wanted[i] for i in order], outliers, missing)

    outcomes = take_all(
        plan or shipped.folder() / "seeing.yaml",
        scenarios,
        protocols,
        out,
        jobs,
        lambda o: echo(f"{o.scenario.number:4}  {line(o.score)}  {o.seconds:.1f} s", err=True),
    )
    rows = summary([o.score for o in outcomes])
    if as_json:
        echo(json.dumps({"format": "mbcacq-challenge/1", "seed": seed, "table": rows, "challenges": [o.to_dict() for o in outcomes]}))
    else:
        print_table(rows)


def print_table(rows: list[dict]) -> None:
    from rich.table import Table

    from mbcacq.challenge.table import COLUMNS, cells

    table = Table()
    for i, name in enumerate(COLUMNS):
        table.add_column(name, justify="left" if i == 0 else "right")
    for entry in rows:
        table.add_row(*cells(entry))
    console = terminal_console()
    (console if console.is_terminal else terminal_console(width=160)).print(table)
