"""Values as rerun components with an explicit Arrow type: float64 stays float64, and no process-wide guess of types is made."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from math import prod
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr


def row(archetype: str, **values: Any) -> rr.DynamicArchetype:
    """One row of an archetype; a value is an array, a number or a list of str. None leaves the component out."""
    return rr.DynamicArchetype(archetype, components={name: array(value) for name, value in values.items() if value is not None})


def named(prefix: str, values: Mapping[str, float]) -> dict[str, Any]:
    """A mapping of numbers as the two components PREFIX_names and PREFIX_values."""
    return {f"{prefix}_names": list(values), f"{prefix}_values": np.array(list(values.values()), dtype=float)} if values else {}


def columns(archetype: str, values: Mapping[str, np.ndarray]) -> list[rr.ComponentColumn]:
    """Columns of k rows from arrays (k,) or (k, n...)."""
    out = []
    for name, value in values.items():
        value = np.ascontiguousarray(value)
        width = prod(value.shape[1:])
        descriptor = _descriptor(archetype, name)
        out.append(rr.ComponentColumn(descriptor, rr.AnyBatchValue(descriptor, array(value)), lengths=np.full(len(value), width)))
    return out


@cache
def _descriptor(archetype: str, name: str) -> rr.ComponentDescriptor:
    return rr.ComponentDescriptor(name).with_builtin_archetype(archetype)


def array(value: Any) -> pa.Array:
    if isinstance(value, str):
        value = [value]
    if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
        return pa.array(value, type=pa.string())
    value = np.atleast_1d(np.asarray(value))
    if value.dtype.kind == "U":
        return pa.array(value.tolist(), type=pa.string())
    if value.dtype.kind not in "iufb":
        raise TypeError(f"values of type {value.dtype} cannot be recorded")
    return pa.array(np.ascontiguousarray(value).reshape(-1))
