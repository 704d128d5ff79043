"""``mbcacq diagnosis-schema``: the JSON Schema of a diagnosis."""

from __future__ import annotations

from mbcacq.cli.declared import subcommand
from mbcacq.cli.terminal import echo
from mbcacq.diagnosis.schema import schema_text


@subcommand("diagnosis-schema")
def command() -> None:
    """Print the JSON Schema of what mbcacq diagnose --json prints, format mbcacq-diagnosis/3."""
    echo(schema_text().rstrip("\n"))
