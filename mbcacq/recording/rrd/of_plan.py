"""What a recorded plan says, for drawing: a plan of another form is no reason not to draw."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import yaml

from mbcacq.model import yaml12

T = TypeVar("T")


def of_plan(plan_yaml: str, read: Callable[[Any], T], otherwise: T) -> T:
    """What ``read`` makes of a plan, ``otherwise`` where the run has no plan of that form."""
    try:
        return read(yaml12.load(plan_yaml))
    except (yaml.YAMLError, KeyError, TypeError, ValueError):
        return otherwise
