"""Every function and method of ``import mbcacq`` documents each of its parameters, what it returns and what it raises (numpydoc)."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator

import pytest

import mbcacq

SECTION = re.compile(r"^(Parameters|Returns|Yields|Raises|Attributes)\n-+\n(.*?)(?=^\w+\n-+\n|\Z)", re.DOTALL | re.MULTILINE)


def exported() -> Iterator[tuple[str, Callable]]:
    """Name and function of everything that is exported, methods included."""
    for name in sorted(n for n in mbcacq.__all__ if not n.startswith("_")):
        thing = getattr(mbcacq, name)
        if not inspect.isclass(thing):
            yield name, thing
            continue
        fields = {f.name for f in dataclasses.fields(thing)} if dataclasses.is_dataclass(thing) else set()
        methods = {k: v for base in reversed(thing.__mro__) if base.__module__.startswith("mbcacq") for k, v in vars(base).items()}
        for method, value in methods.items():
            function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
            if inspect.isfunction(function) and not method.startswith("_") and method not in fields:
                yield f"{name}.{method}", function


def sections(function: Callable) -> dict[str, str]:
    return dict(SECTION.findall(inspect.getdoc(function) or ""))


def named(section: str) -> list[str]:
    """The names that a section describes, several of one line too."""
    entries = [line.partition(" :")[0] for line in section.splitlines() if line and not line.startswith(" ")]
    return [name.strip().lstrip("*") for entry in entries for name in entry.split(",")]


@pytest.mark.parametrize(("name", "function"), list(exported()), ids=[name for name, _ in exported()])
def test_parameters_results_and_errors_are_documented(name, function):
    signature, said = inspect.signature(function), sections(function)
    assert named(said.get("Parameters", "")) == [p for p in signature.parameters if p not in ("self", "cls")]
    if signature.return_annotation not in (None, "None"):
        assert said.get("Returns"), f"{name} does not say what it returns"
    assert not re.search(r"\bRaises? [A-Z]\w+Error\b", inspect.getdoc(function) or ""), f"{name} names errors in running text"
    if "raise " in inspect.getsource(function):
        assert said.get("Raises"), f"{name} does not say what it raises"
