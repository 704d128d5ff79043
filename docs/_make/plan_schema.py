"""The files a user writes (plan, robot, artefact), from the schemas that check them; comments beside a field are its description."""

from __future__ import annotations

import inspect
import re
import typing
from types import UnionType

from pydantic import BaseModel

from mbcacq.model.cell_schema import ArtefactSpec, RobotSpec
from mbcacq.plan.schema import Plan

FIELD = re.compile(r"^\s{4}(\w+)\s*:[^#]*(?:#\s*(.*))?$")


def plan_schema() -> str:
    """Markdown of every object of the three files, each once, in the order met."""
    out = [
        "# Plan, robot and artefact files",
        "",
        "Made from the schemas. Lengths mm, angles deg, times s, masses kg. Unknown keys are refused, with file and line; "
        "`mbcacq schema` prints JSON Schema for editors. How the parts work together: [writing a plan](../plan.md).",
        "",
    ]
    seen: set[type] = set()
    for title, model in (("A plan", Plan), ("A robot file", RobotSpec), ("An artefact file", ArtefactSpec)):
        out += [f"## {title}", ""]
        waiting = [model]
        while waiting:
            one = waiting.pop(0)
            if one in seen:
                continue
            seen.add(one)
            rows, inner = table(one)
            out += ([] if one is model else [f"### {one.__name__}", ""]) + paragraph(one) + rows + [""]
            waiting = inner + waiting
    return "\n".join(out).rstrip() + "\n"


def paragraph(model: type[BaseModel]) -> list[str]:
    text = " ".join((model.__doc__ or "").split()) if model.__doc__ and model.__doc__ != BaseModel.__doc__ else ""
    return [text, ""] if text else []


def table(model: type[BaseModel]) -> tuple[list[str], list[type[BaseModel]]]:
    comments = comments_of(model)
    rows, inner = ["| key | type | default | |", "|---|---|---|---|"], []
    for name, field in model.model_fields.items():
        kinds = models_in(field.annotation)
        inner += kinds
        default = "required" if field.is_required() else shown(field.get_default(call_default_factory=True))
        said = field.description or comments.get(name, "")
        text = "; ".join([*filter(None, [", ".join(limits(field))]), *filter(None, [said])])
        rows.append(f"| `{field.alias or name}` | {kind(field.annotation)} | {default} | {text} |")
    return rows, inner


def comments_of(model: type[BaseModel]) -> dict[str, str]:
    """Field name -> the comment on its line, of the class and those it is derived from."""
    out: dict[str, str] = {}
    for base in reversed([b for b in model.__mro__ if issubclass(b, BaseModel) and b is not BaseModel]):
        for line in inspect.getsource(base).splitlines():
            match = FIELD.match(line)
            if match and match[2]:
                out[match[1]] = match[2].strip().replace("|", r"\|")
    return out


def models_in(annotation) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in typing.get_args(annotation) for m in models_in(part)]


def kind(annotation) -> str:
    """A type in words."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is not None:
        return compound(origin, parts)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation.__name__
    return {float: "number", int: "integer", str: "text", bool: "true or false"}.get(annotation, "any")


def compound(origin, parts: tuple) -> str:
    """A type made of others, in words."""
    if origin is typing.Annotated:
        return kind(parts[0])
    if origin is typing.Literal:
        return " or ".join(f"`{p}`" for p in parts)
    if origin in (typing.Union, UnionType):
        return " or ".join(kind(p) for p in parts if p is not type(None))
    if origin is tuple:
        inner = kind(parts[0]) if parts else ""
        return f"list of {inner}" if len(parts) == 2 and parts[1] is ... else f"{len(parts)} x {inner}"
    return "keys and values" if origin is dict else "any"


def limits(field) -> list[str]:
    words = {
        "gt": "above {:g}",
        "ge": "at least {:g}",
        "lt": "below {:g}",
        "le": "at most {:g}",
        "min_length": "at least {:g} of them",
        "max_length": "at most {:g} of them",
    }
    return [word.format(getattr(m, key)) for m in field.metadata for key, word in words.items() if getattr(m, key, None) is not None]


def shown(value) -> str:
    if value is None:
        return "none"
    if isinstance(value, BaseModel):
        return "as below"
    if isinstance(value, bool):
        return "true" if value else "false"
    if value == "":
        return "empty"
    return f"`{list(value) if isinstance(value, tuple) else value}`"
