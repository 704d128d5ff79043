"""The positioner that is a person: asked on the terminal to place the artefact."""

from __future__ import annotations

import sys
import threading
from collections.abc import Mapping
from typing import Any

from mbcacq.devices import Aborted, ConfigError, ContextDevice, Description, DriverOptions, Field, is_interactive, parse_options, typed_line


class ManualOptions(DriverOptions):
    assume_yes: bool = False


class ManualPositioner(ContextDevice):
    """Prints the prompt on stderr and waits for Enter; 'q' ends the run. ``assume_yes``: believe that all is in place."""

    options_model = ManualOptions

    first_contact = (
        "At each question the artefact stands firmly where the plan says, within station_tolerance_mm, and nobody is in reach.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._options = name, parse_options(ManualOptions, "the manual positioner", options)
        self._stopped = threading.Event()

    @property
    def asks(self) -> bool:
        """Whether somebody is there to be asked once more."""
        return not self._options.assume_yes

    def connect(self) -> None:
        """Raises ConfigError if nobody can be asked."""
        self._stopped.clear()
        self.refuse_unattended()

    def refuse_unattended(self) -> None:
        """Raises ConfigError if nobody can be asked; opens nothing."""
        if not self._options.assume_yes and not is_interactive():
            raise ConfigError(
                "the manual positioner must ask an operator, but standard input is not a terminal; "
                "run in a terminal, or use --yes if every artefact is already in place"
            )

    def describe(self) -> Description:
        return Description("positioner", "operator", (Field("station", "", meaning="where the operator has put the artefact"),))

    def go_to(self, station: str, prompt: str) -> None:
        """Raises Aborted if the operator says so, closes the input, or ``stop`` is called meanwhile."""
        if self._options.assume_yes:
            return
        if not is_interactive():
            raise ConfigError(f"station {station} needs an operator, but standard input is not a terminal; use --yes or a terminal")
        print(f"{prompt}\n  press Enter when it stands still, q and Enter to end the run: ", end="", file=sys.stderr, flush=True)
        answer = typed_line(self._stopped)
        if answer is None or answer.strip().lower() in ("q", "quit"):
            raise Aborted(f"the operator ended the run while station {station} was being prepared")

    def stop(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        self.stop()
