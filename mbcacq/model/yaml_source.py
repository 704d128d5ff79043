"""YAML read with the line of every value, so that each error can name file and line. Only plain data; size and nesting bounded."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import read_bounded
from mbcacq.model.yaml12 import Yaml12Loader

MAX_DEPTH = 40
LOADER = Yaml12Loader

KINDS = {"steps": "a plan", "links": "a robot file", "balls": "an artefact file"}  # by the key that only such a file has

Path_ = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)


class FileLimits(NamedTuple):
    """How much a file may hold: bytes, and values with their keys."""

    bytes: int
    nodes: int


SMALL = FileLimits(1_000_000, 40_000)  # of what a person writes: a plan, a robot file
LARGE = FileLimits(16 << 20, 1_000_000)  # of what a program may have written: a cell with every ball and station


@dataclass(frozen=True)
class YamlFile:
    """One file as read. data: plain Python values; lines: path of a node -> line, counted from 1."""

    path: Path
    text: str
    data: Any
    lines: dict[Path_, int]

    def line(self, *where: str | int) -> int:
        """The line of a node, or of the nearest node around it."""
        while where and where not in self.lines:
            where = where[:-1]
        return self.lines.get(where, 1)

    def part(self, key: str) -> YamlFile:
        """What stands under a key, as a file of its own."""
        inner = {where[1:]: line for where, line in self.lines.items() if where[:1] == (key,)}
        return replace(self, data=self.data[key], lines=inner)

    def error(self, where: Path_, sentence: str) -> ConfigError:
        return ConfigError(f"{self.path}:{self.line(*where)}: {sentence}")

    def validate(self, schema: type[Model]) -> Model:
        """The data checked against a schema; numbers must be numbers. Raises ConfigError for the first thing that is wrong."""
        wanted = next((kind for key, kind in KINDS.items() if key in schema.model_fields and key not in self.data), None)
        given = next((kind for key, kind in KINDS.items() if key in self.data), None)
        if wanted is not None and given is not None:
            raise self.error((), f"this is {given}, where {wanted} is needed; name the right file")
        try:
            # As JSON, because only there strict types still take a list for a tuple.
            return schema.model_validate_json(json.dumps(self.data, default=str), strict=True)
        except ValidationError as error:
            first = error.errors()[0]
            raise self.error(*_explain(first, self.lines)) from None


def read(path: Path, role: str = "file", limits: FileLimits = SMALL) -> YamlFile:
    """Read a YAML file. role: of the file, in sentences. Raises ConfigError for a missing, oversized, broken or ambiguous one."""
    if path.exists() and not path.is_file():  # opening a pipe would wait for ever
        what = "folder" if path.is_dir() else "pipe or a device"
        raise ConfigError(f"{path}: the {role} cannot be read (it is a {what}); correct the path")
    try:
        raw = read_bounded(path, limits.bytes)
    except OSError as error:
        raise ConfigError(f"{path}: the {role} cannot be read ({error.strerror}); correct the path") from None
    if len(raw) > limits.bytes:
        raise ConfigError(f"{path}: the {role} is larger than {limits.bytes} bytes, which no such file is; correct the path")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}: the {role} is not UTF-8 text; save it as UTF-8") from None
    return parse(text, path, role, limits)


def parse(text: str, path: Path, role: str = "file", limits: FileLimits = SMALL) -> YamlFile:
    """The values and lines of a text. Raises ConfigError if it is no plain YAML."""
    if text.lstrip().startswith("<"):
        raise ConfigError(f"{path}:1: this is XML, where a {role} in YAML is needed; of a URDF, mbcacq robot import makes a robot file")
    try:
        data, lines = _values_and_lines(text, path, limits)
    except ConfigError:
        raise
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        if "nesting depth" in str(error.problem):  # libyaml 0.2.6 and later have a limit of their own
            raise _excess(path, line) from None
        tab = "; indent with spaces, not with tabs" if "\t" in _line_of(text, line) else ""
        raise ConfigError(
            f"{path}:{line}: not valid YAML: {error.problem or error.context}{tab or '; correct this line or the one before it'}"
        ) from None
    except (
        yaml.YAMLError,
        ValueError,
        TypeError,
        AttributeError,
        LookupError,
        OverflowError,
        RecursionError,
    ) as error:  # of a tag's own value
        reason = str(error).splitlines()[0] if str(error) else "nested too deeply"
        raise ConfigError(f"{path}:1: not valid YAML: {reason}; correct it") from None
    if not isinstance(data, dict):
        found = "empty" if data is None else "a list" if isinstance(data, list) else "a single value"
        raise ConfigError(
            f"{path}:1: this is no {role}, which must be a mapping of keys to values: it is {found}; write it as lines of 'key: value'"
        )
    return YamlFile(path, text, data, lines)


def _line_of(text: str, line: int) -> str:
    return next(iter(text.split("\n", line)[line - 1 : line]), "")


def _values_and_lines(text: str, path: Path, limits: FileLimits) -> tuple[Any, dict[Path_, int]]:
    """Size and nesting are bounded before anything is built: libyaml composes by recursion, without a limit of its own."""
    _refuse_excess(text, path, limits)
    loader = LOADER(text)
    lines: dict[Path_, int] = {}
    try:
        node = loader.get_single_node()
        if node is None:
            return None, lines
        _walk(node, (), lines, path, limits, [0])
        return loader.construct_document(node), lines
    finally:
        loader.dispose()


def _refuse_excess(text: str, path: Path, limits: FileLimits) -> None:
    """Raises ConfigError, without having read further, where there are too many values or levels."""
    nodes = depth = 0
    for event in yaml.parse(text, Loader=LOADER):
        nodes += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if nodes > limits.nodes or depth > MAX_DEPTH:
            raise _excess(path, event.start_mark.line + 1)


def _excess(path: Path, line: int) -> ConfigError:
    return ConfigError(f"{path}:{line}: too many or too deeply nested values; write them out without aliases")


def _walk(node: yaml.Node, where: Path_, lines: dict[Path_, int], path: Path, limits: FileLimits, count: list[int]) -> None:
    line = node.start_mark.line + 1
    lines[where] = line
    count[0] += 1
    if count[0] > limits.nodes or len(where) > MAX_DEPTH:
        raise _excess(path, line)
    if isinstance(node, yaml.MappingNode):
        first: dict[str, int] = {}
        for key, value in node.value:
            name = str(key.value)
            key_line = key.start_mark.line + 1
            if name in first:
                raise ConfigError(f"{path}:{key_line}: key '{name}' stands here a second time (first in line {first[name]}); remove one")
            first[name] = key_line
            _walk(value, (*where, name), lines, path, limits, count)
            lines[(*where, name)] = key_line
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            _walk(value, (*where, index), lines, path, limits, count)
    elif node.tag == "tag:yaml.org,2002:float":
        try:
            finite = math.isfinite(float(node.value.replace("_", "")))
        except ValueError:
            finite = not any(word in node.value.lower() for word in ("nan", "inf"))
        if not finite:
            raise ConfigError(f"{path}:{line}: {name_of(where)} is {node.value}, not a finite number; correct it")


def _explain(error: Any, lines: dict[Path_, int]) -> tuple[Path_, str]:
    """Where a schema error belongs in the file, and a sentence saying it."""
    where: Path_ = ()
    for part in error["loc"]:
        # The tag of a union stands in the location, but not in the file.
        if (*where, part) in lines:
            where = (*where, part)
    last = error["loc"][-1] if error["loc"] else ""
    kind, given = error["type"], error.get("input")
    if kind == "extra_forbidden":
        return where, f"unknown key '{last}'; correct or remove it"
    if kind == "missing":
        if isinstance(last, int):
            return where, f"{name_of(where)} has too few values; add the missing ones"
        return where, f"{name_of(where)} lacks '{last}'; add it"
    if kind == "union_tag_not_found":
        return where, f"{name_of(where)} lacks 'do'; say which of 'translate', 'look', 'sweep', 'joints', 'scan'"
    if kind == "union_tag_invalid":
        return where, f"{name_of(where)}: do: {error['ctx']['tag']} is not one of {error['ctx']['expected_tags']}; take one of these"
    message = error["msg"][0].lower() + error["msg"][1:]
    shown = f", not {given!r}" if isinstance(given, str | int | float | bool | None) else ""
    return where, f"{name_of(where)}: {message}{shown}; correct it"


def name_of(where: Path_) -> str:
    """steps[2].views[0].tilt_deg"""
    out = ""
    for part in where:
        out += f"[{part}]" if isinstance(part, int) else (f".{part}" if out else str(part))
    return out or "the file"
